"""Surfaces in contact with themselves: against symmetry planes, by the choice of the contactor's side, on ranks, in impact.

./run python3 benchmarks/self_contact.py c square membrane roles flight      # the tables of docs/self_contact.md
./run mpirun -n 3 python3 benchmarks/self_contact.py ring             # on 1, 2, 3 ranks the same numbers
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "tests"), str(Path(__file__).resolve().parents[1])]
from scenes import tip
from test_self_contact import OPENING, PRESSURE, bulbs, c_shape, flattened, flight

from dolfinx_mortar_al import quasistatic, self_target
from dolfinx_mortar_al.contact_pair import ContactPair


def say(*words: object) -> None:
    if MPI.COMM_WORLD.rank == 0:
        print(*words, flush=True)


def c() -> None:
    """The C against its plane of symmetry."""
    say("| cells along | force, plane | force | difference | friction / force | deflection, plane | deflection |")
    for n in (48, 96, 192):
        results = []
        for half in (True, False):
            problem, p = c_shape(MPI.COMM_WORLD, half, 0.0 if half else 0.3, n)
            for _ in quasistatic.march(problem, p, to=PRESSURE, increments=8):
                pass
            at = (np.cos(OPENING + 0.1), np.sin(OPENING + 0.1))
            results.append((np.abs(problem.pairs[0].force()), tip(problem, at)[1]))
        (plane, deflection), (own, moved) = results
        say(
            f"| {n} | {plane[1]:.5e} | {own[1]:.5e} | {own[1] / plane[1] - 1:+.1e} | {own[0] / own[1]:.1e} | "
            f"{deflection:.5f} | {moved:.5f} |"
        )


def square() -> None:
    """The C with square tips, whose inner corners meet first, against its plane of symmetry."""
    say("| cells along | friction | force, plane | force | deflection, plane | deflection | iterations | rejected |")
    for n in (48, 96):
        for half, friction in ((True, 0.0), (False, 0.3), (False, 0.6)):
            problem, p = c_shape(MPI.COMM_WORLD, half, friction, n, square=True)
            count = np.zeros(2, dtype=int)
            for step in quasistatic.march(problem, p, to=2 * PRESSURE, increments=16):
                count += step.iterations, step.rejected
            force = abs(problem.pairs[0].force()[1])
            deflection = tip(problem, (np.cos(OPENING + 0.1), np.sin(OPENING + 0.1)))[1]
            if half:
                plane = force, deflection
            else:
                say(
                    f"| {n} | {friction} | {plane[0]:.5e} | {force:.5e} | {plane[1]:.5f} | {deflection:.5f} | "
                    f"{count[0]} | {count[1]} |"
                )


def membrane() -> None:
    """Two bulbs against one and a plane, with the crease's multiplier determined by the contactor's side alone or by both."""
    say("| n | force, plane | force | force, both sides | top, plane | top | top, both sides |")
    whole = ContactPair._divide
    for n in (16, 32, 64):
        forces, tops = [], []
        for half, both in ((True, False), (False, False), (False, True)):

            def divide(pair: ContactPair, both: bool = both) -> None:
                whole(pair)
                pair.blocks.left_out = None if both else pair.blocks.left_out

            ContactPair._divide = divide  # type: ignore[method-assign]
            problem, p = bulbs(MPI.COMM_WORLD, half, 0.0, n)
            for _ in quasistatic.march(problem, p, to=3500.0, increments=4):
                pass
            forces.append(f"{abs(problem.pairs[0].force()[0]):.1f}")
            tops.append(f"{tip(problem, (0.5, 0.0))[1]:.5f}")
        say(f"| {n} | {' | '.join(forces + tops)} |")
    ContactPair._divide = whole  # type: ignore[method-assign]


def roles() -> None:
    """A ring pressed flat along x, with roles by colouring and by the facets' numbers alone."""
    say("| contactor | plane's force | bore's force | closed area | iterations |")
    colouring = self_target.assign
    for name, rule in (("colouring", colouring), ("number", lambda *a: np.zeros(len(a[-1]), dtype=np.int64))):
        self_target.assign = rule
        force, own, area, iterations = flattened(MPI.COMM_WORLD, size=0.02, axis=0, increments=12)
        say(f"| {name} | {abs(force[0]):.1f} | {abs(own[0]):.1f} | {area:.4f} | {iterations} |")
    self_target.assign = colouring


def ring() -> None:
    """A ring pressed flat, all digits."""
    force, own, area, iterations = flattened(MPI.COMM_WORLD)
    say(f"{MPI.COMM_WORLD.size} ranks: {force[1]:.12e} {own[1]:.12e} {area:.12e} {iterations} iterations")


def in_flight() -> None:
    """A ring that closes in flight."""
    say(
        "| Δt (s) | rate (1/s) | touches in | rejected | friction | impact loss | defect | momentum | spin | deepest/facet |"
    )
    for rate in (80.0, 160.0):
        for Δt in (1e-3, 5e-4, 2.5e-4):
            energy, momenta, ledger, touched, rejected, deepest = flight(0.015, Δt, rate)
            drift = np.abs(np.array(ledger.momentum) - momenta[:2]).max() / (abs(momenta[2]) / 0.1)
            spin = abs(ledger.angular_momentum[0] / momenta[2] - 1)
            say(
                f"| {Δt:g} | {rate:g} | {touched} | {rejected} | {ledger.friction_dissipation / energy:.2%} | "
                f"{ledger.impact_loss / energy:.2%} | {ledger.energy_defect / energy:.0e} | {drift:.0e} | {spin:.0e} | "
                f"{deepest / 0.015:.3f} |"
            )


if __name__ == "__main__":
    tables = {"c": c, "square": square, "membrane": membrane, "roles": roles, "ring": ring, "flight": in_flight}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="+", choices=list(tables))
    for name in parser.parse_args().tables:
        tables[name]()
