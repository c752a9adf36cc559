"""Collisions of two free bodies in the plane or in space, and what is watched of them: energy, momenta, penetration, loss.

For the benchmarks of impact; run those.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dolfinx_mortar_al import Contact, ContactProblem, Surface, dynamics, materials, obstacles
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.dynamics import StepFailure
from dolfinx_mortar_al.law import OPEN
from meshes.gmsh_session import distribute
from meshes.round_bodies import Round, RoundBodies

Array = NDArray[np.float64]

DENSITY, NU = 1000.0, 0.3


@dataclass(frozen=True)
class Block:
    """A rectangle by its lower left corner and sides, with elements of a size (m); its whole edge may touch."""

    corner: tuple[float, float]
    sides: tuple[float, float]
    size: float

    def create(self, order: int) -> tuple[Any, Any]:
        """(mesh, facet tags); straight edges whatever the order of displacements."""
        low, high = np.array(self.corner), np.add(self.corner, self.sides)
        cells = [max(1, round(side / self.size)) for side in self.sides]
        domain = mesh.create_rectangle(MPI.COMM_WORLD, [low, high], cells)
        domain.topology.create_connectivity(1, 2)
        edge = mesh.exterior_facet_indices(domain.topology)
        return domain, mesh.meshtags(domain, 1, edge, np.full(len(edge), RIM, dtype=np.int32))


RIM = RoundBodies.rim(0)


@dataclass(frozen=True)
class Ball:
    """A ball of tetrahedra of a size, centre, radius and size in m; its whole surface may touch."""

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 0.1
    size: float = 0.03

    def _build(self, gmsh: Any, order: int) -> None:
        model = gmsh.model
        ball = model.occ.addSphere(*self.centre, self.radius)
        model.occ.synchronize()
        model.addPhysicalGroup(3, [ball], 1)
        model.addPhysicalGroup(2, [tag for _, tag in model.getBoundary([(3, ball)], oriented=False)], RIM)
        for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
        model.mesh.setSizeCallback(lambda *_: self.size)
        model.mesh.generate(3)
        model.mesh.setOrder(order)

    def create(self, order: int) -> tuple[Any, Any]:
        """(mesh, facet tags); with order 2 facets follow the sphere."""
        domain, _, tags = distribute(lambda gmsh: self._build(gmsh, order), MPI.COMM_WORLD, 3)
        return domain, tags


@dataclass(frozen=True)
class Cube:
    """A cube with rounded edges, of hexahedra: half its side and the radius of its edges in m, cells along a side, turned by
    a rotation vector (rad); its whole surface may touch."""

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    half: float = 0.1
    rounded: float = 0.04
    cells: int = 6
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def create(self, order: int) -> tuple[Any, Any]:
        """(mesh, facet tags); straight edges between nodes whatever the order of displacements."""
        n, a = (self.cells,) * 3, self.half
        domain = mesh.create_box(MPI.COMM_WORLD, [[-a] * 3, [a] * 3], n, mesh.CellType.hexahedron)
        X = domain.geometry.x
        inner = np.clip(X, self.rounded - a, a - self.rounded)  # the rounded cube is all within `rounded` of this box
        apart, reach = X - inner, np.abs(X - inner).max(axis=1, keepdims=True)
        length = np.linalg.norm(apart, axis=1, keepdims=True)
        X[:] = inner + apart * reach / np.where(length > 0, length, 1.0)
        X[:] = Rotation.from_rotvec(self.turned).apply(X) + self.centre
        domain.topology.create_connectivity(2, 3)
        outside = mesh.exterior_facet_indices(domain.topology)
        return domain, mesh.meshtags(domain, 2, outside, np.full(len(outside), RIM, dtype=np.int32))


Shape = Round | Block | Ball | Cube


@dataclass(frozen=True)
class Body:
    """A body with its Young's modulus (Pa), velocity (m/s), and which edge touches: the rim or a ring's bore."""

    shape: Shape
    E: float
    velocity: tuple[float, ...]
    touches: int = RIM


@dataclass
class Collision:
    """Bodies that may touch, the first being the contactor, or one body and an obstacle."""

    bodies: tuple[Body, ...]
    step: float
    friction: float = 0.0
    order: int = 2
    obstacle: obstacles.Obstacle | None = None
    motions: list[dynamics.Motion] = field(init=False)
    problem: ContactProblem = field(init=False)

    def __post_init__(self) -> None:
        self.motions, surfaces = [], []
        for body in self.bodies:
            if isinstance(body.shape, Round):
                domain, _, tags = RoundBodies((body.shape,), order=self.order).create()
            else:
                domain, tags = body.shape.create(self.order)
            u = fem.Function(fem.functionspace(domain, ("Lagrange", self.order, (domain.geometry.dim,))))
            moduli = (fem.Constant(domain, value) for value in materials.lame(body.E, NU))  # one compiled form for all
            motion = dynamics.Motion(u, materials.NeoHookean(*moduli), density=DENSITY, step=self.step)
            motion.velocity.interpolate(lambda X, v=body.velocity: np.outer(v, np.ones(X.shape[1])))
            self.motions.append(motion)
            surfaces.append(Surface(domain, tags, body.touches))
        target = surfaces[1] if self.obstacle is None else self.obstacle
        contact = Contact(surfaces[0], target, friction=self.friction)
        self.problem = ContactProblem(self.motions, contacts=[contact])

    @property
    def energy(self) -> float:
        """Kinetic and strain energy (J)."""
        return float(sum(sum(motion.energies()) for motion in self.motions))

    def momenta(self) -> Array:
        """(bodies, 3 or 6) momentum and angular momentum about the origin."""
        return np.array([motion.momenta() for motion in self.motions])

    def masses(self) -> Array:
        """(bodies,) in kg, in the plane per metre of thickness."""
        one = [fem.Constant(m.u.function_space.mesh, 1.0) for m in self.motions]
        return np.array([m.integral(fem.form(DENSITY * c * m.dx)) for m, c in zip(self.motions, one, strict=True)])


def mean_gap(pair: ContactPair) -> float:
    """Largest weighted penetration ∫ N g / ∫ N of the multiplier's nodes (m) on this rank, over closed facets: what the
    method holds at zero, besides its augmentation."""
    k, points = pair.kinematics, pair.integration
    N = np.abs(pair.multiplier.at(points.facet, points.η)[:, :, 0])
    nodes = pair.multiplier.dofs[points.facet]
    total, closed, gap = (np.zeros(nodes.max() + 1) for _ in range(3))
    for sums, values in (
        (total, np.ones(len(pair.j))),
        (closed, pair.state.status != OPEN),
        (gap, np.where(k.at.facing, k.at.g, 0.0)),
    ):
        np.add.at(sums, nodes, N * (pair.j * values)[:, None])
    whole = closed > (1 - 1e-9) * total
    return float((gap[whole] / total[whole]).max(initial=0.0))


@dataclass
class Watched:
    """What was seen of a run. Energies in J; drifts and penetrations as shares (of E₀, the momenta of the bodies one by one,
    and `size`, a facet)."""

    energy: float
    above: float = -np.inf
    momentum: float = 0.0
    spin: float = 0.0
    deepest: float = 0.0
    mean_gap: float = 0.0
    worst_gain: float = 0.0
    loss: float = 0.0
    friction: float = 0.0
    defect: float = 0.0
    steps: int = 0
    iterations: int = 0
    rejected: int = 0
    largest_force: float = 0.0
    seconds: float = 0.0
    failure: str = ""

    @property
    def sound(self) -> bool:
        """What holds for every collision, however long its steps are."""
        kept = self.above <= 1e-9 and self.momentum <= 1e-10 and self.spin <= 1e-10
        return kept and self.worst_gain >= -1e-9


def watch(scene: Collision, to: float, size: float, *, free: bool = True) -> Watched:
    """Run a collision to a time; `size` (m) is that of a facet of the contactor, `free` whether momentum is to stay."""
    *_, watched = watch_steps(scene, to, size, free=free)
    return watched


def watch_steps(scene: Collision, to: float, size: float, *, free: bool = True) -> Iterator[Watched]:
    """The same, after each step."""
    start, pair = scene.momenta(), scene.problem.pairs[0]
    d = scene.problem.gdim
    one_by_one = np.linalg.norm(start[:, :d], axis=1)
    radius = pair.area / (2 * np.pi) if d == 2 else np.sqrt(pair.area / (4 * np.pi))
    scale = one_by_one.sum(), max(np.linalg.norm(start[:, d:], axis=1).sum(), one_by_one.sum() * radius)
    seen, clock, last = Watched(scene.energy), time.process_time(), (0.0, 0.0)
    try:
        for step in dynamics.march(scene.problem, to=to):
            ledger = step.ledger
            seen.above = max(seen.above, ledger.total / seen.energy - 1)
            if free:
                now = np.array([*ledger.momentum, *ledger.angular_momentum]) - start.sum(axis=0)
                seen.momentum = max(seen.momentum, float(np.linalg.norm(now[:d]) / scale[0]))
                seen.spin = max(seen.spin, float(np.linalg.norm(now[d:]) / scale[1]))
            seen.deepest = max(seen.deepest, step.penetration / size)
            seen.mean_gap = max(seen.mean_gap, mean_gap(pair) / size)
            now_lost = ledger.impact_loss, ledger.friction_dissipation
            seen.worst_gain = min(
                seen.worst_gain, *((b - a) / seen.energy for a, b in zip(last, now_lost, strict=True))
            )
            seen.loss, seen.friction = last = now_lost
            seen.defect = max(seen.defect, abs(ledger.energy_defect) / seen.energy)
            seen.steps, seen.iterations = seen.steps + 1, seen.iterations + step.iterations
            seen.rejected += step.rejected
            seen.largest_force = max(seen.largest_force, float(np.linalg.norm(step.forces[0])))
            seen.seconds = time.process_time() - clock
            yield seen
    except StepFailure as failure:
        seen.failure = str(failure)
        seen.seconds = time.process_time() - clock
        yield seen
