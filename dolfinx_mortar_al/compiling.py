"""Forms and expressions compiled once for all values of the numbers in them.

FFCx writes numbers into its kernels, so that another modulus, density or load is another kernel, which takes a second or so
to compile. Numbers that are no part of a formula are Constants here, of which a kernel knows but the place.
"""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from dolfinx_mortar_al.validation import check_linear
from dolfinx_mortar_al.versions import whole_form

__all__ = ["compiled", "compiled_expression"]

ROUND = 16  # multiples of 1/16 up to 16 are of formulas, and stay, for the compiler to make the most of


class _NumbersAsConstants(MultiFunction):
    """Maps an expression to one with Constants of `domain` in place of numbers."""

    def __init__(self, domain: Mesh) -> None:
        super().__init__()
        self._domain = domain

    expr = MultiFunction.reuse_if_untouched

    def real_value(self, number: Any) -> Any:
        value = float(number)
        is_round = abs(value) <= ROUND and (ROUND * value).is_integer()
        return number if is_round else fem.Constant(self._domain, value)

    def power(self, power: Any, base: Expr, _: Expr) -> Any:
        """Exponents stay: their derivatives and kernels are those of the number."""
        return self.reuse_if_untouched(power, base, power.ufl_operands[1])


def compiled(form: ufl.Form, domain: Mesh, written: ufl.Form | None = None) -> fem.Form:
    """`form` compiled, or what is wrong with the form that the user has `written`, from which it comes. What the form
    compiler has in its cache is sound, so that nothing needs to be looked at before.

    Raises:
        ValueError: on every rank, if what is written is not linear in its test function.
    """
    try:
        return fem.form(map_integrand_dags(_NumbersAsConstants(domain), whole_form(form, domain)))
    except Exception:
        if written is not None:
            check_linear("F", written)
        raise


def compiled_expression(quantity: Expr, points: NDArray[Any], domain: Mesh) -> fem.Expression:
    """`quantity` at `points` (n, tdim) of the reference cell."""
    return fem.Expression(map_expr_dag(_NumbersAsConstants(domain), quantity), points, comm=domain.comm)
