"""The verification suite: cases with known answers, run by ``python3 -m dolfinx_mortar_al.verify``."""

from dolfinx_mortar_al.verify import (
    blocks,
    hemispheres,
    hertz,
    impact,
    ironing,
    klang,
    mindlin,
    patch,
    printed_patches,
    rings,
    twist,
)
from dolfinx_mortar_al.verify.case import CASES, Case, Outcome, Quantity, Row, Run, rows

__all__ = [
    "CASES",
    "Case",
    "Outcome",
    "Quantity",
    "Row",
    "Run",
    "blocks",
    "hemispheres",
    "hertz",
    "impact",
    "ironing",
    "klang",
    "mindlin",
    "patch",
    "printed_patches",
    "rings",
    "rows",
    "twist",
]
