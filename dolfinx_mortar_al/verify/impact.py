"""A bar that hits a wall (SDNV100)."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from dolfinx_mortar_al import ContactProblem, Surface, dynamics, materials, obstacles
from dolfinx_mortar_al.verify.case import Effort, Outcome, Quantity, Run, case
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import make_contact, space, unknowns

__all__: list[str] = []

LENGTH, WIDTH, E, RHO = 0.2, 0.02, 2e11, 8000.0  # m, m, Pa, kg/m³
PRINTED, SCALE = 100.0, 1e-2  # m/s, and what share of it (and of the gap) is run
SPEED, GAP = PRINTED * SCALE, 2e-3 * SCALE
WAVE = (E / RHO) ** 0.5
TOUCH, PART = GAP / SPEED, GAP / SPEED + 2 * LENGTH / WAVE
STRESS = RHO * WAVE * PRINTED
FACE = 1

EXACT = "d'Alembert (code_aster SDNV100)"


def bar(n: int) -> tuple[dict[str, tuple[float, float]], Effort, int, Any]:
    """n cells along the bar, a wave crosses a cell in a step."""
    faces = {(0, 0): FACE}
    domain, _, facets = build([grid([np.linspace(GAP, GAP + LENGTH, n + 1), np.linspace(0, WIDTH, 2)], faces, order=1)])
    _, u = space(domain, 1)
    Δt = LENGTH / WAVE / n
    motion = dynamics.Motion(u, materials.saint_venant_kirchhoff(E, 0.0), density=RHO, step=Δt)
    motion.velocity.x.array.reshape(-1, 2)[:, 0] = -SPEED
    wall = obstacles.RigidPlane([0.0, 0.0], [1.0, 0.0])
    problem = ContactProblem(motion, contacts=[make_contact(Surface(domain, facets, FACE), wall)])
    effort, begin, path, ledger = Effort(), perf_counter(), [], None
    for step in dynamics.march(problem, to=1.4e-4):
        effort.iterations += step.iterations
        effort.rejected += step.rejected
        ledger = step.ledger
        path.append((step.time, step.forces[0][0] / WIDTH / SCALE, ledger.momentum[0] / (RHO * LENGTH * WIDTH) / SCALE))
    effort.seconds = perf_counter() - begin
    assert ledger is not None
    t, stress, speed = np.array(path).T
    touching = t[stress > 1e-3 * STRESS]
    steady = (t > TOUCH + 0.1 * (PART - TOUCH)) & (t < TOUCH + 0.9 * (PART - TOUCH))
    energy = RHO * LENGTH * WIDTH * SPEED**2 / 2
    values = {
        "stress": (float(stress[steady].mean()), STRESS),
        "first contact": (float(touching[0] - Δt), TOUCH),
        "release": (float(touching[-1]), PART),
        "speed after it": (float(speed[-1]), PRINTED),
        "energy lost": (ledger.impact_loss / energy, 1 / (3 * n)),
        "energy balance": (ledger.energy_defect / energy, 0.0),
    }

    def draw(axes: Any) -> None:
        axes.step(t * 1e6, stress / 1e9, label="computed")
        axes.plot(
            np.array([0, TOUCH, TOUCH, PART, PART, 1.4e-4]) * 1e6,
            np.array([0, 0, 1, 1, 0, 0]) * STRESS / 1e9,
            "k-",
            linewidth=0.7,
        )
        axes.set(xlabel="t (μs)", ylabel="stress at the wall (GPa)")

    return values, effort, unknowns(u), draw


@case(
    "bar-on-wall",
    "Bar on a wall in dynamics (SDNV100)",
    [
        Quantity("stress", EXACT + "; St Venant–Kirchhoff adds its strain, 2e-4", 5e-3, "Pa"),
        Quantity("first contact", EXACT + ", to a step", 1 / 160, "s", PART - TOUCH),
        Quantity("release", EXACT + ", to two steps", 2 / 160, "s", PART - TOUCH),
        Quantity("speed after it", EXACT + "; its energy is right to the loss", 1e-2, "m/s"),
        Quantity("energy lost", "that of the mass that stops, h/(3L) of the bar's", 0.2, order=0),
        Quantity("energy balance", "of the scheme, exact", 1e-9, scale=1.0, order=0),
    ],
)
def bar_on_wall(quick: bool) -> Outcome:
    """A steel bar (L = 0.2 m, E = 200 GPa, ρ = 8000 kg/m³, ν = 0) flies at 100 m/s, 2 mm from a rigid wall: contact
    from 20 to 100 μs with a stress of ρcV = 4 GPa, then it flies back at 100 m/s. That is linear theory at strains of
    2 %: run with a hundredth of speed and gap, and multiplied. Order 1, one step per cell and wave.
    """
    runs = []
    sizes = (20, 40) if quick else (20, 40, 80, 160)
    for n in sizes:
        values, effort, count, draw = bar(n)
        runs.append(Run(f"{n} cells", 1 / n, values, effort, count, draw))
    return Outcome(runs, coarse=160 / sizes[-1])
