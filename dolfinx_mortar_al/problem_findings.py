"""What a problem finds amiss in a converged state: what its pairs and monitors find, and bodies that contact alone holds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.bulk_stiffness import BulkStiffness
from dolfinx_mortar_al.contact_motions import ContactMotions
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.monitors import Finding, Monitor
from dolfinx_mortar_al.pieces import Piece
from dolfinx_mortar_al.reductions import sum_over
from dolfinx_mortar_al.standing import Standing
from dolfinx_mortar_al.ties import Ties

__all__ = ["TOLD", "ProblemFindings"]

Array = NDArray[np.float64]

LET_GO = (
    "contact alone held it and does no more, so that nothing says where it is; press it on, hold one of its nodes, or let it "
    "move with dynamics.march"
)
FREE = (
    "supports do not keep it in place and no load presses it on, so that nothing says where it is, or whether what it lies "
    "on carries it along; press it on, hold one of its nodes, or let it move with dynamics.march"
)
ROUNDED = (
    "share of the contact forces that round-off of positions makes, as far as can be told: what it presses is stiff for so "
    "small a load, or lies far from the origin; move the meshes there, or take these forces for none"
)
SLIDE = (
    "share of the contact forces on it, or of a load that pushes it along, that contact does not bear but a tie to where it "
    "was, as next to nothing resists: from pressures on a coarse mesh, or a load under which it is about to slide or tip, of "
    "which it may be a large part; refine its surface, or prescribe the motion that is free, of one node"
)
SLIDES = (
    "{}: {:.1%} of the friction that its pressure allows is in use in the last of these states, and little else keeps a body "
    "from sliding there: past that it slides off: prescribe its motion along the surface, or let it move with dynamics.march"
)
NEARLY_ALL = 0.9  # of the friction: what the next sixteenth of a load's increments asks for may be more than is left
TOLD = 1e-3  # share of the contact forces that a tie may bear, or round-off may be, unsaid
OUT_OF_BALANCE = 0.1  # of the worst: loose bodies that a failed solve names
NOISE = 1e-3  # share of round-off in a body's forces below which a tie bears nothing, and contact does not press on it
ROUND_OFF = 2e-15  # of a piece's stiffness times its diameter: in its forces
UNLOADED = 1e-9  # of the most that has pressed on a piece: what Newton's tolerance leaves of it presses on nothing


class ProblemFindings:
    """Findings of a contact problem."""

    comm: MPI.Intracomm
    bodies: Bodies
    pairs: list[ContactPair]
    monitors: list[Monitor]
    ties: Ties | None
    standing: Standing
    #: (pieces,) which ones nothing presses on
    _free: NDArray[np.bool_]
    #: (pieces,) of each pair, those that it may touch
    _touched: list[NDArray[np.bool_]]
    _contact_motions: ContactMotions
    stiffness: BulkStiffness
    #: (pieces,) how many diameters each was from its reference position at the start of the solve, 1 at least
    _travel: Array

    @property
    def is_at_start(self) -> bool:
        """Whether there has been no equilibrium yet."""
        return any(pair.active.guessed for pair in self.pairs)

    @property
    def force_floor(self) -> Array:
        """(pieces,) round-off in the bulk's forces on each (N): strains are differences of displacements, which may be many
        times its diameter."""
        return ROUND_OFF * self.stiffness.firmness * self._travel

    @property
    def floating(self) -> list[Piece]:
        """The pieces of bodies that nothing but contact holds."""
        return [piece for _, piece in self._loose_pieces()]

    def _loose_pieces(self) -> list[tuple[int, Piece]]:
        """The same, with the number of each among all pieces."""
        bodies = zip(self.bodies.first_piece, self.bodies.bodies, strict=True)
        return [(first + piece.number, piece) for first, body in bodies for piece in body.floating]

    def findings(self) -> list[Finding]:
        """What the monitors find below their bounds in the present state, and pairs whose integration is too coarse or
        multiplier too fine, whose ε is far from the bulk's, whose surfaces are prescribed to overlap, have passed through
        each other or overlap unfelt (collective)."""
        looks = [monitor.look() for monitor in self.monitors]
        for pair in self.pairs:
            looks += [
                pair.prescribed_overlap() or pair.pushed_node(),
                pair.coarse_integration(),
                pair.fine_multiplier(),
                pair.far_turn(),
            ]
            looks += [*pair.unfelt(), *pair.far_augmentation(), pair.turned_force()]
            looks += [pair.dipping_friction(pair.friction_coefficient)]
        return [finding for finding in looks if finding is not None] + self._let_go() + self._tied()

    def _tied(self) -> list[Finding]:
        """Pieces of which ties bear more than TOLD of the contact forces in this state (collective)."""
        found = []
        for n, piece in self._loose_pieces():
            borne = float(self.ties.borne[n]) if self.ties is not None else 0.0
            if borne > TOLD:
                found.append(Finding(f"slide of {piece}", borne, (), SLIDE, fatal=False))
        return found

    def _let_go(self) -> list[Finding]:
        """Pieces that contact alone held in the last equilibrium and that nothing touches now; those that nothing presses on,
        other than in that one; and those on which round-off presses (collective)."""
        if not self.floating:
            return []
        now, before = self._in_contact()
        pressing = self._pressing()
        self._free = np.asarray(pressing <= np.maximum(self._no_press(), UNLOADED * self.standing.pressing))
        rounded = self._contact_round_off() / np.maximum(pressing, 1e-300)
        found = []
        for n, piece in self._loose_pieces():
            mine = np.array([touched[n] for touched in self._touched], dtype=bool)
            if (before & mine).any() and not (now & mine).any():
                found.append(Finding(f"contacts of {piece}", 0.0, (), LET_GO, fatal=False))
            elif self._free[n] and not self.standing.free[n]:
                found.append(Finding(f"contact forces on {piece}", 0.0, (), FREE, fatal=False))
            elif not self._free[n] and rounded[n] > TOLD:
                found.append(Finding(f"round-off on {piece}", float(rounded[n]), (), ROUNDED, fatal=False))
        return found

    def never_met(self, said: Sequence[Finding]) -> list[Finding]:
        """Of a march without contact, how near the surfaces of each pair are, but of one that may touch itself, or of which
        the findings `said` tell more (collective)."""
        quiet = [pair for pair in self.pairs if not any(f.name.startswith(f"{pair.name}: ") for f in said)]
        return [pair.never_met() for pair in quiet if not pair.target.is_contactor]

    def narrow_zones(self) -> list[Finding]:
        """Of a state that is left, contacts that their facets do not resolve: each begins with such (collective)."""
        looks = [pair.narrow_zone() for pair in self.pairs]
        return [finding for finding in looks if finding is not None]

    def unheld(self, off: PETSc.Vec) -> list[str]:
        """The floating pieces that these nodal forces (N) put out of balance by at least a tenth of the worst, in words:
        those that a pair may hold, and those that nothing does; but for such as contact held firmly in the last equilibrium
        and touches still (collective)."""
        touched = self._touched_now() > 0
        squares = np.bincount(self.bodies.piece_of_dof, weights=off.array_r**2, minlength=self.bodies.pieces)
        forces = np.nan_to_num(np.sqrt(sum_over(self.comm, squares)), nan=np.inf)
        found = []
        for n, piece in self._loose_pieces():
            if self.standing.held and touched[n]:
                continue
            held = any(pieces[n] for pieces in self._touched)
            found.append((forces[n], f"{'contact alone' if held else 'nothing'} holds {piece}"))
        worst = max((force for force, _ in found), default=0.0)
        return [words for force, words in found if force >= OUT_OF_BALANCE * worst]

    def about_to_slide(self) -> list[str]:
        """Of pairs that hold a floating piece and bear nearly all the friction that they can, in an equilibrium: what to do
        (collective)."""
        if self.is_at_start:
            return []
        loose = np.zeros(self.bodies.pieces, dtype=bool)
        loose[[n for n, _ in self._loose_pieces()]] = True
        holding = [pair for pair, pieces in zip(self.pairs, self._touched, strict=True) if (pieces & loose).any()]
        used = {pair.name: pair.friction_in_use() for pair in holding}
        return [SLIDES.format(name, share) for name, share in used.items() if share > NEARLY_ALL]

    def is_in_contact(self) -> bool:
        """Whether any pair is in contact in the last equilibrium (collective)."""
        return bool(self._in_contact()[1].any())

    def _in_contact(self) -> NDArray[np.bool_]:
        """(2, pairs) which pairs are in contact now, and were in the last equilibrium (collective)."""
        here = np.array([(pair.active.closed.any(), pair.was_in_contact()) for pair in self.pairs], dtype=int)
        return np.asarray(sum_over(self.comm, here.reshape(-1, 2)).T > 0)

    def _touched_now(self) -> Array:
        """(pieces,) by how many pairs in contact each is touched now (collective)."""
        return self._contact_motions.on_pieces(self._in_contact()[0])

    def is_pressed(self) -> bool:
        """Whether contact presses on anything, by more than round-off (collective)."""
        return bool((self._pressing() > self._no_press()).any())

    def _pressing(self) -> Array:
        """(pieces,) what pairs press on each piece with, balanced or not (N, collective)."""
        return self._contact_motions.on_pieces([pair.pressing() for pair in self.pairs])

    def _no_press(self) -> Array:
        """(pieces,) forces (N) below which contact does not press on a piece, and ties bear nothing."""
        return np.maximum(NOISE * self.force_floor, self._contact_round_off())

    def _contact_round_off(self, counts: NDArray[np.bool_] | None = None) -> Array:
        """(pieces,) what the round-off of positions makes of the contact forces on each (N), of the pairs that count."""
        every = np.array([pair.force_round_off for pair in self.pairs])
        return self._contact_motions.on_pieces(list(every if counts is None else every * counts))
