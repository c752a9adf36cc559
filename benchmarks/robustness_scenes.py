"""Families of random contact scenes, each drawn from a seed and a number alone.

A scene is two bodies, a lower one that is held and an upper one that is driven, and stages: each moves, turns or loads the
upper body from where the stage before has left it, by equal increments. `draw` chooses everything uniformly (ratios
log-uniformly) over ranges that are wide and yet leave a solution to be found: the softer body is not pressed by more than
15 % of its height (St Venant–Kirchhoff, which collapses in compression: 8 %; at a sharp corner half of it), beams and
membranes stay where an answer is known to exist. Bodies are held by Dirichlet conditions, but for the inclined block under
its own weight, which contact alone holds along the normal and in half of its frictional scenes altogether.

In space, meshes have 1 to 12 facets along the contact and stages 2 to 20 increments, so that a scene takes seconds.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "CONTACT", "FAMILIES", "HELD", "LOADED", "LOWER", "PLANE", "UPPER", "Body", "Scene", "Stage", "draw", "from_json",
    "motion", "turned",
]  # fmt: skip

Array = NDArray[np.float64]

LOWER, UPPER = 1, 2  # cells
CONTACT, HELD, LOADED = 1, 2, 3  # facets of body b: 10 b + this
FAMILIES = (
    "punch", "die", "half ring", "roller", "tread block", "blocks", "beams", "membranes", "inclined block", "sphere",
    "dome",
)  # fmt: skip
PLANE = FAMILIES[:6]  # plane and driven by displacements: what a peer without load control can do, too
MEMBRANE_PRESSURE = 4366.0 / 2e6  # per Young's modulus: where the two membranes of section 4.2 lock at a shift of 1 m


@dataclass(frozen=True)
class Body:
    """One body, touched at y = 0 by the other one (lengths in m, E in Pa).

    `shape`: "block" (width, height[, depth]), "arc" (outer and inner radius, angle in rad, its lowest point touching), "disc"
    (radius) or "line" (a membrane: length, thickness). A block's contact face recedes from y = 0 by its `profile`: flat,
    ("parabola", curvature), ("barrel", curvature across x), ("round", radius of the corners) or ("wave", amplitude, length);
    its middle is at x = `centre`.
    `cells` count along x, y[, z]; a disc's, around. Faces are named left, right, bottom, top, front, back.
    """

    shape: str
    size: tuple[float, ...]
    cells: tuple[int, ...]
    E: float
    nu: float
    material: str
    contact: tuple[str, ...]
    held: tuple[str, ...]
    loaded: tuple[str, ...] = ()
    profile: tuple[Any, ...] = ("flat",)
    centre: float = 0.0

    def __post_init__(self) -> None:
        faces = (*self.contact, *self.held, *self.loaded)
        if len(set(faces)) < len(faces):
            raise ValueError(f"faces {faces}: a face is touched, held or loaded")


@dataclass(frozen=True)
class Stage:
    """What the upper body's held faces and load have reached at the end of `increments` equal ones: motion (m) and turn (rad,
    about the disc's or arc's centre), load (see `Scene.load`). `slide`: target facets passed per increment.
    """

    name: str
    increments: int
    move: tuple[float, ...]
    turn: float = 0.0
    load: tuple[float, ...] = (0.0, 0.0)
    slide: float = 0.0


@dataclass(frozen=True)
class Scene:
    """Everything of a scene. Lengths are in m, moduli and tractions in Pa.

    `gap` is between the bodies at the start (negative: they overlap); all is turned by `incline` (rad) about z. `swap`: the
    lower body is the contactor. `load`: "none", "weight" (force per volume), "dead" or "follower" (traction on the loaded
    face; the follower's along its own normal axis), "tip" (the loaded face's top is driven down), "pressure" (of both
    membranes). `held`: the upper body's held faces are driven in "all" components, along "x" only, or "not" at all. `tilt`:
    of each body about its own middle at first (rad), about z, the lower one's in space about x.
    """

    seed: int
    number: int
    family: str
    dim: int
    order: int
    geometry_order: int
    simplices: bool
    lower: Body
    upper: Body
    gap: float
    friction: float
    swap: bool
    stages: tuple[Stage, ...]
    load: str = "none"
    held: str = "all"
    incline: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)

    @property
    def name(self) -> str:
        return f"{self.family} {self.seed}/{self.number}"

    def json(self) -> dict[str, Any]:
        return asdict(self)


def from_json(data: dict[str, Any]) -> Scene:
    """The scene that `Scene.json` wrote."""

    def tuples(d: dict[str, Any]) -> dict[str, Any]:
        return {k: tuple(v) if isinstance(v, list) else v for k, v in d.items()}

    stages = tuple(Stage(**tuples(s)) for s in data["stages"])
    bodies = {k: Body(**tuples(data[k])) for k in ("lower", "upper")}
    return Scene(**data | bodies | {"stages": stages})


def turned(angle: float, x: Array) -> Array:
    """(n, dim) vectors turned by `angle` (rad) about z."""
    R = np.eye(x.shape[1])
    R[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    return x @ R.T


def motion(scene: Scene, stage: int, t: float, X: Array) -> tuple[Array, Array]:
    """Displacement (m) of the upper body's held points X (n, dim), and the load, at t ∈ [0, 1] of a stage."""
    start = scene.stages[stage - 1] if stage else Stage("start", 1, (0.0,) * scene.dim)
    end = scene.stages[stage]
    reached = ((getattr(start, k), getattr(end, k)) for k in ("move", "turn", "load"))
    move, turn, load = ((1 - t) * np.array(a) + t * np.array(b) for a, b in reached)
    radius = scene.upper.size[0] if scene.upper.shape in ("arc", "disc") else 0.0
    centre = turned(scene.incline, np.array([[0.0, radius + scene.gap, 0.0][: scene.dim]]))
    return turned(float(turn), X - centre) + centre - X + turned(scene.incline, move[None]), load


# ---------------------------------------------------------------- drawing


class _Dice:
    """A random generator with the ways of drawing that scenes need."""

    def __init__(self, seed: int, number: int) -> None:
        self.rng = np.random.default_rng([seed, number])

    def uniform(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def ratio(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(math.log(low), math.log(high))))

    def chance(self, share: float = 0.5) -> bool:
        return bool(self.rng.random() < share)

    def one_of(self, *values: Any) -> Any:
        return values[int(self.rng.integers(len(values)))]

    def increments(self, stages: int, dim: int) -> list[int]:
        """Of each stage, 2 to 50 (in space 20), log-uniformly; no more than 60 in all."""
        n = np.array([self.ratio(2, 50 if dim == 2 else 20) for _ in range(stages)])
        return [max(2, int(k)) for k in np.round(n * min(1.0, 60 / n.sum()))]


def _bodies(dice: _Dice) -> tuple[dict[str, Any], dict[str, Any], float]:
    """Materials of the lower and the upper body, and how far the softer one may be pressed, as a share of its height."""
    ratio, E = dice.ratio(1e-3, 1e3), dice.ratio(1e2, 1e7)
    materials = [dice.one_of("saint_venant_kirchhoff", "neo_hookean") for _ in range(2)]
    lower, upper = (
        {"E": e, "nu": dice.uniform(0.2, 0.45), "material": m}
        for e, m in zip((E / math.sqrt(ratio), E * math.sqrt(ratio)), materials, strict=True)
    )
    soft = [b["material"] for b in (lower, upper) if b["E"] < 3 * min(lower["E"], upper["E"])]
    return lower, upper, 0.08 if "saint_venant_kirchhoff" in soft else 0.15


def _gap(dice: _Dice, facets: tuple[float, float], depth: float) -> float:
    """A start open, touching or overlapping by a fraction of a facet (m)."""
    overlap = min(dice.uniform(0.02, 0.3) * min(facets), 0.3 * depth)
    return float(dice.one_of(dice.uniform(0.02, 0.5) * min(facets), 0.0, -overlap))


def _facets(dice: _Dice, finest: float, coarsest: float, dim: int = 2) -> tuple[float, float]:
    """Lengths of the lower and the upper body's facets (m), their ratio between 1:8 and 8:1; in space, the one side may be
    the finer the coarser the other."""
    ratio = dice.ratio(1 / 8, 8)
    wide = max(ratio, 1 / ratio)
    finest /= wide ** (1 / 3) if dim == 3 else 1.0
    fine = dice.ratio(finest, max(finest, min(coarsest / wide, 4 * finest)))
    return (fine * wide, fine) if ratio < 1 else (fine, fine * wide)


def draw(seed: int, number: int) -> Scene:
    """The scene of that seed and number; families take turns."""
    dice, family = _Dice(seed, number), FAMILIES[number % len(FAMILIES)]
    order = dice.one_of(1, 2)
    common = {
        "seed": seed, "number": number, "family": family, "dim": 3 if family in ("sphere", "dome") else 2, "order": order,
        "geometry_order": dice.one_of(1, order), "simplices": dice.chance(), "swap": dice.chance(),
        "friction": 0.0 if dice.chance(0.25) else dice.uniform(0.0, 1.0),
    }  # fmt: skip
    rest = {"beams": _beams, "membranes": _membranes}.get(family, _on_slab)
    return Scene(**common | rest(dice, common))


def _upper(dice: _Dice, family: str, h: float, dim: int, order: int) -> tuple[dict[str, Any], float, float, bool]:
    """Shape of a body that is pressed on a slab with facets of length h: (its fields, width, height, has a sharp edge)."""
    sides = dice.one_of(("bottom",), ("bottom", "left", "right"))
    fields: dict[str, Any] = {"shape": "block", "contact": sides, "held": ("top",)}
    if family in ("half ring", "roller"):
        R = dice.uniform(0.4, 0.6)
        inner = R * (dice.uniform(0.7, 0.9) if family == "half ring" else 0.3)
        around, across = max(4, round(math.pi * R / h)), max(2, min(4, round((R - inner) / h)))
        fields |= {"shape": "arc", "size": (R, inner, math.pi), "cells": (around, across), "contact": ("bottom",)}
        fields["held"] = ("left", "right") if family == "half ring" else ("left", "right", "top")
        if family == "roller" and dice.chance():
            disc = {"contact": ("left", "right"), "held": ("top",)}
            fields |= {"shape": "disc", "size": (R,), "cells": (max(9, round(2 * math.pi * R / h)),), **disc}
        return fields, 2 * R, R, False
    width, height = dice.uniform(0.8, 1.2), dice.uniform(0.4, 0.8)
    if family == "tread block":
        width, height = dice.uniform(0.3, 0.6), dice.uniform(0.6, 1.0)
    curved = {
        "punch": ("parabola", dice.ratio(0.1, 1.5) / width), "sphere": ("parabola", dice.uniform(0.8, 1.2) / width),
        "dome": ("parabola", dice.ratio(0.05, 0.5) / width),
    }.get(family)  # fmt: skip
    round_edge = family in ("die", "tread block", "blocks") and dice.chance()
    if curved:
        fields |= {"profile": curved, "contact": ("bottom",)}
    elif round_edge:
        fields |= {"profile": ("round", dice.uniform(0.1, 0.4) * min(width, height)), "contact": ("bottom",)}
    across = max(1, min(2, round(height / h))) if dim == 3 else max(2, min(4, round(height / h)))
    along = max(3 - order if dim == 3 else 2, round(width / h))  # one facet is curved only where it is of second order
    fields |= {"size": (width, height, width)[:dim], "cells": (along, across, along)[:dim]}
    return fields, width, height, not (curved or round_edge)


def _on_slab(dice: _Dice, common: dict[str, Any]) -> dict[str, Any]:
    """A body pressed on a slab and dragged along it; the inclined block also by its weight."""
    family, dim, order = (common[k] for k in ("family", "dim", "order"))
    lower, upper, share = _bodies(dice)
    rounded = family in ("half ring", "roller")
    finest = {(2, 1): 1 / 40, (2, 2): 1 / 24, (3, 1): 1 / 8, (3, 2): 1 / 4}[dim, order]
    h = _facets(dice, finest, 1.0 if dim == 3 else 0.3 if rounded else 0.5, dim)
    shape, width, height, sharp = _upper(dice, family, h[1], dim, order)
    thick, margin = dice.uniform(0.4, 1.0), 0.4 * width if dim == 2 else 0.2 * width
    wave = dice.chance() and dim == 2 and family != "inclined block"
    depth = dice.uniform(0.2, 1.0) * share * (0.5 if sharp else 1.0) * min(thick, height) / (1.8 if wave else 1.0)
    gap, (press, drag) = _gap(dice, h, depth), dice.increments(2, dim)
    # the slab is as long as the drag needs, within its share of the unknowns; longer drags take fewer increments
    slide, passed = dice.ratio(0.1, 10), h[1] if common["swap"] else h[0]
    longest = max({(2, 1): 140, (2, 2): 90, (3, 1): 18, (3, 2): 12}[dim, order] * h[0] - width - 2 * margin, passed / 5)
    drag = max(2, min(drag, int(longest / (slide * passed))))
    slide = min(slide, longest / (drag * passed))
    way = dice.one_of(-1, 1) * slide * passed * drag
    length, deep = width + 2 * margin + abs(way), width + 2 * margin
    layers = (2 if order == 1 else 1) if dim == 3 else max(2, min(4, round(thick / h[0])))
    cells = (max(2, round(length / h[0])), layers, max(2, round(deep / h[0])))[:dim]
    wavy = ("wave", dice.uniform(0.1, 0.4) * depth, max(dice.uniform(0.8, 2.0), 6 * h[0])) if wave else ("flat",)
    if dim == 3 and dice.chance():
        wavy = ("barrel", dice.uniform(0.05, 0.3))
    slab = {
        "shape": "block",
        "size": (length, thick, deep)[:dim],
        "cells": cells,
        "contact": ("top",),
        "held": ("bottom",),
    }
    bodies = {"lower": Body(**lower, **slab, profile=wavy, centre=way / 2), "upper": Body(**upper, **shape)}
    if family == "inclined block" and dice.chance():
        return bodies | _weight(dice, common["friction"], bodies, height, (press, drag), way, slide)
    down, side = -(depth + gap), dice.uniform(-0.1, 0.1) * width if dim == 3 else 0.0
    turn = 0.0
    if family == "roller":  # between dragging, rolling and spinning; the held part stays clear of the slab
        turn = -float(np.clip(dice.one_of(0.0, 1.0, dice.uniform(0, 1.5)) * way / shape["size"][0], -1.0, 1.0))
    stages = (
        Stage("press", press, (0.0, down, 0.0)[:dim]),
        Stage("drag", drag, (way, down, side)[:dim], turn=turn, slide=slide),
    )
    incline = dice.uniform(-0.8, 0.8) if family == "inclined block" else 0.0
    curved = {"geometry_order": order} if dim == 3 and shape["cells"][0] == 1 else {}
    return bodies | curved | {"gap": gap, "stages": stages, "incline": incline}


def _weight(
    dice: _Dice, friction: float, bodies: dict[str, Body], height: float, n: tuple[int, int], way: float, slide: float
) -> dict[str, Any]:
    """The inclined block under its weight, level at first; then tilted, held by friction, or held and pushed along x."""
    softest = min(body.E for body in bodies.values())
    weight = dice.uniform(0.005, 0.04) * softest / height
    free = friction > 0.1 and dice.chance()
    α = math.atan(dice.uniform(0.2, 0.8) * friction) if free else dice.uniform(0.0, 0.7)
    tilted = (math.copysign(weight * math.sin(α), -way), -weight * math.cos(α))
    stages = [Stage("weigh", n[0], (0.0, 0.0), load=(0.0, -weight))]
    if free:
        stages.append(Stage("tilt", n[1], (0.0, 0.0), load=tilted))
    else:
        stages.append(Stage("push", n[1], (way, 0.0), load=tilted, slide=slide))
    touched = tuple(face for face in bodies["upper"].contact if face != "left")
    block = replace(bodies["upper"], contact=touched, held=() if free else ("left",))
    return {"upper": block, "gap": 0.0, "stages": tuple(stages), "load": "weight", "held": "not" if free else "x"}


def _beams(dice: _Dice, common: dict[str, Any]) -> dict[str, Any]:
    """Two cantilevers of 1 m, the upper one bent by a load of up to 4.8 EI/L² of itself and (if it is softer) the other."""
    lower, upper, _ = _bodies(dice)
    h = _facets(dice, 1 / 100 if common["order"] == 1 else 1 / 60, 1 / 10)
    heights = [dice.uniform(0.04, 0.08) for _ in range(2)]
    load, (n,) = dice.one_of("follower", "dead", "tip"), dice.increments(1, 2)
    EI = [b["E"] * t**3 / 12 for b, t in zip((lower, upper), heights, strict=True)]
    traction = -dice.uniform(1.0, 4.8) * (EI[1] + min(EI)) / heights[1]
    if load == "tip":
        stage = Stage("bend", n, (0.0, -dice.uniform(0.1, 0.6)))
    else:
        stage = Stage("bend", n, (0.0, 0.0), load=(0.0, traction))
    bodies = [
        Body(shape="block", size=(1.0, t), cells=(round(1 / k), dice.one_of(1, 2) * (3 - common["order"])), **b,
             contact=(face,), held=("left",), loaded=("right",) if face == "bottom" else ())
        for b, t, k, face in zip((lower, upper), heights, h, ("top", "bottom"), strict=True)
    ]  # fmt: skip
    gap = float(np.clip(_gap(dice, h, 0.01), -0.1 * min(heights), 0.2 * min(heights)))
    return {"lower": bodies[0], "upper": bodies[1], "gap": gap, "stages": (stage,), "load": load}


def _membranes(dice: _Dice, common: dict[str, Any]) -> dict[str, Any]:
    """Two membranes of 1 m inflated against each other: section 4.2's, of equal stiffness, or one above the other."""
    lower, upper, _ = _bodies(dice)
    apart = dice.chance()
    if apart:
        lower["E"], shift, height = upper["E"], dice.uniform(0.5, 1.0), 1.0
        pressure = dice.uniform(0.75, 0.92) * MEMBRANE_PRESSURE * upper["E"]
    else:  # both rise as circular arcs until they meet; the pressure then goes on a little
        E, rise = min(lower["E"], upper["E"]), dice.uniform(0.25, 0.5)
        pressure = _arc_pressure(rise) * E
        other = min(rise, 0.5 * rise * E / max(lower["E"], upper["E"]))
        shift, height = dice.uniform(0.0, 0.2), (rise + other) * dice.uniform(0.8, 0.95)
    (n,), h = dice.increments(1, 2), _facets(dice, 1 / 160, 1 / 15)
    bodies = [
        Body(shape="line", size=(1.0, 1e-3), cells=(round(1 / k),), E=b["E"], nu=0.3, material="neo_hookean_membrane",
             contact=(), held=(), centre=x)
        for b, k, x in zip((lower, upper), h, (0.0, shift), strict=True)
    ]  # fmt: skip
    stages = (Stage("inflate", n, (0.0, 0.0), load=(0.0, pressure)),)
    same = {"gap": height, "stages": stages, "load": "pressure", "geometry_order": 1, "simplices": False}
    return {"lower": bodies[0], "upper": bodies[1]} | same


def _arc_pressure(rise: float) -> float:
    """Pressure per Young's modulus that inflates a membrane of 1 m × 1 mm to a circular arc of that rise (m), ν = 0.3."""
    radius = (0.25 + rise**2) / (2 * rise)
    stretch = 2 * radius * math.asin(min(1.0, 0.5 / radius))
    return 1e-3 / 2.6 * (stretch - stretch**-3) / radius
