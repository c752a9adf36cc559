"""Two discs collide off-centre: energy, momenta, penetration and loss for steps and meshes; and scenes drawn at random.

    ./run python3 benchmarks/two_discs.py
    ./run python3 benchmarks/two_discs.py --friction 0.4 --sizes 0.015 --steps 1e-3 5e-4
    ./run python3 benchmarks/two_discs.py --bodies balls
    ./run python3 benchmarks/two_discs.py --family 1 --scenes 40

Discs of R = 0.1 m, neo-Hookean, E = 1e6 Pa, ν = 0.3, ρ = 1000 kg/m³, with velocities (±0.5, ±2) m/s, centres 0.08 m
off; P2 elements of h and 1.3 h, 0.06 s. Shares of energy are of E₀; penetration is of h: "deepest" at a closed point, "mean"
the weighted gap of a multiplier's node, which the method holds. Restitution is that along the line of centres at the
start. Seconds are of CPU.

In space: balls of the same R (tetrahedra of h and 1.3 h), or cubes with rounded edges and sides of 2 R (hexahedra of h and
1.25 h), turned so that an edge meets another; P1, velocities (±0.5, ±0.2, ±2) m/s, centres 0.085 m off.

The family: discs, rings, a block on a ring; μ 0 … 1, ratio of stiffness 1 … 1000, speed 0.01 … 0.5 of the softer body's
wave speed, Δt 0.05 … 2 of h over the relative speed, P1 and P2. A scene is sound if energy never exceeds E₀ (1 + 1e-9),
contact never gives energy, and both momenta stay to 1e-10; a march may end early, but only by saying so.
"""

import argparse
import math
from dataclasses import replace

import numpy as np
from collisions import DENSITY, NU, Ball, Block, Body, Collision, Cube, Round, Shape, Watched, watch

R, GAP, OFFSET, END, ROUNDED = 0.1, 1e-3, 0.08, 0.06, 0.04
OFFSETS = np.array([OFFSET, 0.03])  # in space
SIZES = {"discs": [0.015, 0.0075, 0.00375], "balls": [0.03, 0.02], "cubes": [0.04, 0.02]}
LONGEST = 150  # steps of a scene of the family


def discs(h: float, step: float, friction: float, ratio: float, speed: float) -> Collision:
    """The scene of the table; `ratio` of the second disc's E to the first's, `speed` a factor on both velocities."""
    centre = (1 + GAP / (2 * R)) * np.array([OFFSET, math.sqrt((2 * R) ** 2 - OFFSET**2)])
    first, second = Round(radius=R, size=h), Round(centre=tuple(centre), radius=R, size=1.3 * h)
    return against(first, second, (0.5, 2.0), step, friction, ratio, speed)


def balls(h: float, step: float, friction: float, ratio: float, speed: float) -> Collision:
    """The same with balls."""
    centre = (1 + GAP / (2 * R)) * np.array([*OFFSETS, math.sqrt((2 * R) ** 2 - OFFSETS @ OFFSETS)])
    first, second = Ball(radius=R, size=h), Ball(tuple(centre), R, 1.3 * h)
    return against(first, second, (0.5, 0.2, 2.0), step, friction, ratio, speed, order=1)


def cubes(h: float, step: float, friction: float, ratio: float, speed: float) -> Collision:
    """Cubes on edge: the first turned about x by 45°, the second about y."""
    lift = 2 * (math.sqrt(2) * (R - ROUNDED) + ROUNDED) + GAP
    first = Cube(half=R, rounded=ROUNDED, cells=round(2 * R / h), turned=(math.pi / 4, 0.0, 0.0))
    coarser = Cube((*OFFSETS, lift), R, ROUNDED, round(2 * R / (1.25 * h)), (0.0, math.pi / 4, 0.0))
    return against(first, coarser, (0.5, 0.2, 2.0), step, friction, ratio, speed, order=1)


def against(
    first: Shape, second: Shape, v: tuple[float, ...], step: float, friction: float, ratio: float, speed: float,
    order: int = 2,
) -> Collision:  # fmt: skip
    """Two bodies with velocities ±v times `speed`."""
    pairs = (first, 1e6, speed), (second, ratio * 1e6, -speed)
    return Collision(tuple(Body(shape, E, tuple(s * c for c in v)) for shape, E, s in pairs), step, friction, order)


SCENES = {"discs": discs, "balls": balls, "cubes": cubes}


def restitution(scene: Collision, before: np.ndarray) -> float:
    """Of the relative velocity of the centres along their line at the start; `before` are the momenta then. The first body is
    at the origin."""
    n, m, d = np.array(scene.bodies[1].shape.centre), scene.masses(), scene.problem.gdim
    approach, parting = ((p[0, :d] / m[0] - p[1, :d] / m[1]) @ n for p in (before, scene.momenta()))
    return float(-parting / approach)


def shown(seen: Watched, order: float, e: float) -> list[str]:
    """The columns after Δt."""
    E0 = seen.energy
    return [
        f"{seen.above:.0e}", f"{seen.momentum:.0e}", f"{seen.spin:.0e}", f"{seen.deepest:.2%}", f"{seen.mean_gap:.0e}",
        f"{seen.loss / E0:.3%}", "–" if math.isnan(order) else f"{order:.2f}", f"{seen.friction / E0:z.3%}", f"{e:.4f}",
        str(seen.steps), str(seen.iterations), str(seen.rejected), f"{seen.seconds:.1f}",
    ]  # fmt: skip


def table(args: argparse.Namespace) -> None:
    columns = ["μ", "h (m)", "Δt (s)", "E/E₀ − 1, largest", "momentum", "angular momentum", "deepest", "mean"]
    columns += ["impact loss", "order", "friction", "restitution", "steps", "iterations", "rejected", "CPU s"]
    print("| " + " | ".join(columns) + " |\n" + "|" + "---|" * len(columns), flush=True)
    for friction in args.friction:
        for h in args.sizes or SIZES[args.bodies]:
            last = (math.nan, math.nan)  # Δt and loss
            for step in args.steps:
                scene = SCENES[args.bodies](h, step, friction, args.stiffness_ratio, args.speed)
                before = scene.momenta()
                seen = watch(scene, END / args.speed, h)
                order = math.log(seen.loss / last[1]) / math.log(step / last[0]) if last[1] > 0 else math.nan
                last = step, seen.loss
                row = [f"{friction:g}", f"{h:g}", f"{step:g}", *shown(seen, order, restitution(scene, before))]
                print("| " + " | ".join(row) + " |" + f" {seen.failure}" * bool(seen.failure), flush=True)


def drawn(rng: np.random.Generator) -> tuple[str, Collision, float, float]:
    """A scene at random: (in words, scene, time to run, size of the contactor's facets)."""
    kind = str(rng.choice(["discs", "rings", "block on ring"]))
    friction, ratio = float(rng.choice([0.0, rng.uniform(0, 1)])), 10 ** rng.uniform(0, 3)
    speed, courant, order = (
        10 ** rng.uniform(-2, math.log10(0.5)),
        10 ** rng.uniform(math.log10(0.05), math.log10(2)),
        int(rng.choice([1, 2])),
    )
    c = math.sqrt(1e6 * (1 - NU) / (DENSITY * (1 + NU) * (1 - 2 * NU)))
    h, v, offset, gap = R / 5, speed * c, float(rng.uniform(-0.9, 0.9)), 0.02 * R
    step = courant * h / v
    stiff = (1e6, ratio * 1e6) if rng.random() < 0.5 else (ratio * 1e6, 1e6)
    bore = R * rng.uniform(0.5, 0.75)
    below = Round(radius=R, bore=0.0 if kind == "discs" else bore, size=h * rng.uniform(0.8, 1.5))
    if kind == "block on ring":
        x = offset * R
        bottom = R + gap  # of the block, when it lies over the top
        other: Round | Block = Block((x - 0.8 * R, bottom), (1.6 * R, 0.5 * R), h)
    else:
        n = np.array([offset, math.sqrt(1 - offset**2)])
        other = replace(below, centre=tuple((2 * R + gap) * n), size=h)
    slide = v * rng.uniform(-0.5, 0.5)
    fast = (slide, -v * math.sqrt(1 - (slide / v) ** 2) / 2)
    bodies = (Body(other, stiff[0], fast), Body(below, stiff[1], (-fast[0], -fast[1])))
    if rng.random() < 0.5:
        bodies = bodies[::-1]
    steps = min(LONGEST, max(10, math.ceil((8 * R / c + 4 * gap / v) / step)))
    words = (
        f"{kind}, P{order}, μ {friction:.2f}, ratio {stiff[1] / stiff[0]:.3g}, v/c {speed:.3g}, Δt v/h {courant:.3g}"
    )
    return words, Collision(bodies, step, friction, order), steps * step, h


def family(seed: int, scenes: int, only: int | None) -> None:
    print("| scene | | sound | E/E₀ − 1, largest | momentum | angular momentum | least loss per step | deepest | impact loss "
          "| friction | steps | iterations | rejected | CPU s | |")  # fmt: skip
    print("|" + "---|" * 15)
    unsound, failed = [], []
    for k in range(scenes) if only is None else [only]:
        words, scene, to, h = drawn(np.random.default_rng([seed, k]))
        seen = watch(scene, to, h)
        unsound += [k] * (not seen.sound)
        failed += [k] * bool(seen.failure)
        print(
            f"| {k} | {words} | {'yes' if seen.sound else 'NO'} | {seen.above:.0e} | {seen.momentum:.0e} | {seen.spin:.0e} "
            f"| {seen.worst_gain:.0e} | {seen.deepest:.2%} | {seen.loss / seen.energy:.3%} "
            f"| {seen.friction / seen.energy:z.3%} | {seen.steps} | {seen.iterations} | {seen.rejected} "
            f"| {seen.seconds:.1f} | {seen.failure[:200]} |",
            flush=True,
        )
    print(f"\n{scenes} scenes, not sound: {unsound}, ended early: {failed}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--steps", type=float, nargs="+", default=[2e-3 / 2**k for k in range(5)], help="Δt in s (%(default)s)")
    add("--bodies", choices=SCENES, default="discs", help="(%(default)s)")
    add("--sizes", type=float, nargs="+", help=f"h in m ({SIZES})")
    add("--friction", type=float, nargs="+", default=[0.0, 0.4], help="(%(default)s)")
    add("--stiffness-ratio", type=float, default=1.0, help="of the second disc to the first (%(default)s)")
    add("--speed", type=float, default=1.0, help="factor on both velocities; the time is divided by it (%(default)s)")
    add("--family", type=int, metavar="SEED", help="scenes drawn at random instead")
    add("--scenes", type=int, default=40, help="of the family (%(default)s)")
    add("--only", type=int, help="one scene of the family")
    args = parser.parse_args()
    if args.family is None:
        table(args)
    else:
        family(args.family, args.scenes, args.only)


if __name__ == "__main__":
    main()
