"""A monitor of bodies in motion: does the ledger keep what no force has changed, and do surfaces stay apart?

Looked at after each step of :func:`~dolfinx_mortar_al.dynamics.march`. A finding warns; it does not stop the run.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.ledger import Ledger
from dolfinx_mortar_al.monitors import Finding
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over

__all__ = ["DriftMonitor"]

Array = NDArray[np.float64]

SHARE = 1e-6  # of a run's energy or momenta: what Newton's tolerance, 1e-11, leaves in 1e5 steps, all to one side
STORED = 0.01  # of the round-off of a body's forces times its size: that of its stored energy
# of a facet: one that turns by an angle θ rises by θ/8 of its length over its chord; two that meet, each turning by 1 rad
DEPTH = 0.25
SWING = 0.01  # of the prescribed velocities: what round-off and their differences at the start leave is less
TURNS = 3  # of a velocity in as many steps that are no vibration
STILL = (
    1e-12  # of the velocity that all energy would give the bodies: the velocities of a support at rest are round-off
)
# of the energy in a step, beside what supports and obstacles put in meanwhile, half of which is lost where they meet what is
# at rest: as much as the row of nodes that lands of a body five cells high has
LOSS = 0.1
# of the inertia of a mean node that moves by the body's diameter in a step: slower ones lose more. Steel of 10 mm in steps of
# 1 ms has 1e-8, and 1e12 times as much where its density is said in t/mm³
DROWNED = 1e-3

UNBOOKED = (
    "the ledger has no source of it: does a load act that the Motion does not know (external=), or have moduli, density or "
    "thickness been changed?"
)
MISSING = (
    "it has gone where the ledger does not look: have moduli, density or thickness been changed, or does a load act that the "
    "Motion does not know (external=)?"
)
OF_THE_SCHEME = (
    'forces weighted over the step (force="trapezoidal", or a form with theta > 1/2) do not keep energy: take shorter steps, '
    'or a law with force="consistent"; or a load acts that the Motion does not know (external=)'
)
PUSHED = "no external force is known to act on these bodies: does a load act that the Motion does not know (external=)?"
LOST = (
    "so much of the energy has been lost in one step to nodes that come to rest on what they hit: shorter steps and finer "
    "meshes there lose less"
)
SWINGS = (
    "prescribed velocities swing about that of their way from step to step, as where a support starts or stops at once: let "
    "it do so over some steps, or end the march there and begin another"
)
DROWNS = (
    "beside so stiff a body its inertia in a step is next to nothing, and velocities are made of round-off: are density and "
    "moduli in the same units (kg/m³ and Pa, t/mm³ and MPa)? if so, take shorter steps, or quasistatic.march"
)
DEEP = "a closed point lies deep behind the target's surface: take shorter steps or finer facets"


class DriftMonitor:
    """Energy that is not that of the start and the work done, losses in single impacts, momenta of free bodies, penetration,
    prescribed velocities that swing; before the first step inertia that is lost in round-off.

    Energy is not looked at while prescribed displacements move, whose work the ledger does not have; momenta where nothing
    is prescribed and there are neither external loads nor rigid obstacles, components one by one.

    Args:
        problem: of the march.
        start: the ledger at the start of the march.
    """

    def __init__(self, problem: ContactProblem, start: Ledger) -> None:
        self._problem, self._motions, self._start = problem, problem.motions, start
        comm, d = problem.comm, problem.gdim
        self._prescribed = [body.prescribed().x.array > 0 for body in problem.bodies.bodies]
        held = np.any([some.reshape(-1, d).any(axis=0) for some in self._prescribed], axis=0)
        held = np.asarray(sum_over(comm, held.astype(int)) > 0)
        self._any_prescribed = bool(held.any())
        loaded = any(m.external is not None or m.has_forms for m in problem.motions) or any(
            p.target.is_rigid for p in problem.pairs
        )
        self._free = ~held & (not loaded)
        self._is_weighted = any(motion.has_weighted_forces for motion in problem.motions)
        reach = [np.abs(body.mesh.geometry.x).max(initial=0.0) for body in problem.bodies.bodies]
        self._reach = max_over(comm, float(max(reach)))
        self._round_off = STORED * float(problem.force_floor.sum()) * problem.bodies.diameter()  # (J)
        self._mass = sum(motion.mass for motion in problem.motions)
        self._last = start  # ledger of the last step
        self._velocities: list[Array] = []  # prescribed ones after the last steps (m/s)
        self._energy = 0.0  # the largest so far, of what has been there or was put in (J)

    def foresee(self, step: float) -> list[Finding]:
        """Bodies whose inertia drowns in the round-off of their elastic forces in a `step` (s) (collective)."""
        problem = self._problem
        rounded = problem.force_floor / problem.stiffness.diameters  # (pieces,) in their stiffness (N/m)
        found = []
        for k, (motion, first, body) in enumerate(
            zip(self._motions, problem.bodies.first_piece, problem.bodies.bodies, strict=True)
        ):
            nodes = motion.u.function_space.dofmap.index_map.size_global
            share = float(rounded[first : first + body.pieces].max() * step**2 * nodes / motion.mass)
            if share > DROWNED:
                found.append(
                    Finding(f"round-off of motion {k}'s forces (share of its inertia)", share, (), DROWNS, False)
                )
        return found

    def look(self, ledger: Ledger, depths: Sequence[float]) -> list[Finding]:
        """What has drifted; `depths` is the penetration of each pair (m) (collective)."""
        start = self._start
        put_in = start.size + abs(ledger.external_work - start.external_work)
        self._energy = energy = max(self._energy, put_in, ledger.size)  # its round-off stays where it goes again
        found = []
        gain = ledger.energy_defect - start.energy_defect
        if abs(gain) > SHARE * energy + self._round_off and not self._is_driven():
            if gain > 0:
                found.append(("energy gained (J)", gain, OF_THE_SCHEME if self._is_weighted else UNBOOKED))
            elif not self._is_weighted and all(motion.theta == 0.5 for motion in self._motions):
                found.append(("energy lost (J)", -gain, MISSING))
        lost, put_in = ledger.impact_loss - self._last.impact_loss, ledger.received - self._last.received
        self._last = ledger
        if lost - max(put_in, 0.0) > LOSS * energy + self._round_off:
            found.append(("impact loss (share of the energy)", lost / energy, LOST))
        if swing := self._swing(np.sqrt(2 * energy / self._mass) if self._mass > 0 else 0.0):
            found.append(("prescribed velocity's swing (m/s)", swing, SWINGS))
        scale = np.sqrt(2 * self._mass * energy)  # the momentum of all if all of the energy were kinetic
        moved = np.abs(np.subtract(ledger.momentum, start.momentum))[self._free].max(initial=0.0)
        if moved > SHARE * scale:
            found.append(("momentum gained (N s)", moved, PUSHED))
        turned = float(np.abs(np.subtract(ledger.angular_momentum, start.angular_momentum)).max(initial=0.0))
        if self._free.all() and turned > SHARE * scale * self._reach:
            found.append(("angular momentum gained (N m s)", turned, PUSHED))
        for pair, depth in zip(self._problem.pairs, depths, strict=True):
            share = depth / pair.target.size
            if share > DEPTH:
                found.append((f"{pair.name}: penetration (target facets)", share, DEEP))
        return [Finding(name, float(value), (), meaning, False) for name, value, meaning in found]

    def _swing(self, speed: float) -> float:
        """By how much prescribed velocities go to and fro from step to step (m/s), 0 where they do not, or by no more than
        round-off of a `speed` (m/s) of the bodies (collective)."""
        if not self._any_prescribed:
            return 0.0
        now = [m.velocity.x.array[some] for m, some in zip(self._motions, self._prescribed, strict=True)]
        self._velocities = [*self._velocities, np.concatenate(now)][-TURNS - 1 :]
        if len(self._velocities) <= TURNS:
            return 0.0
        v = np.array(self._velocities)
        changes = v[1:] - v[:-1]
        squares, products = (changes[-1:] ** 2).sum(axis=1), (changes[1:] * changes[:-1]).sum(axis=1)
        parts = np.concatenate([squares, (v**2).sum(axis=1), products])
        size, *sums = sum_over(self._problem.comm, parts).tolist()
        largest, turn = max(sums[: TURNS + 1]), max(sums[TURNS + 1 :])
        if size <= SWING**2 * largest or turn > -0.9 * size:
            return 0.0
        swing = max_over(self._problem.comm, float(np.abs(changes[-1]).max(initial=0.0)))
        return swing if swing > STILL * speed else 0.0

    def _is_driven(self) -> bool:
        """Whether a prescribed displacement moves (collective)."""
        if not self._any_prescribed:
            return False
        speeds = [m.velocity.x.array[some] for m, some in zip(self._motions, self._prescribed, strict=True)]
        return any_over(self._problem.comm, any(v.any() for v in speeds))
