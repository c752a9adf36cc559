"""Frictional contact under large deformation for FEniCSx: the mixed augmented-Lagrangian form of Le van and Nguyen."""

import gc

from dolfinx_mortar_al import dynamics, loads, materials, membrane, monitors, obstacles, output, quasistatic
from dolfinx_mortar_al.body import Body
from dolfinx_mortar_al.checkpoint import Checkpoint
from dolfinx_mortar_al.contact import Contact
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.meshfile import read_msh
from dolfinx_mortar_al.newton import NewtonResult, NewtonSolver
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.ranks import end_together, share_out_alike
from dolfinx_mortar_al.reactions import reaction
from dolfinx_mortar_al.surface import Surface

__all__ = [
    "Body",
    "Checkpoint",
    "Contact",
    "ContactPair",
    "ContactProblem",
    "NewtonResult",
    "NewtonSolver",
    "Surface",
    "dynamics",
    "loads",
    "materials",
    "membrane",
    "monitors",
    "obstacles",
    "output",
    "quasistatic",
    "reaction",
    "read_msh",
]

monitors.show_warnings()
end_together()
share_out_alike()
gc.freeze()  # what imports leave lives as long as the program: no need to walk through it again and again
