"""What each of Newton's rules is worth: the two beams (section 4.1, 20 steps to 20 N) with one rule off at a time.

    ./run python3 benchmarks/contact_decisions.py

The rules are described in docs/newton.md; their constants are those of `contact.py` and `quasistatic.py`.
"""

import contextlib
import io
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "demos"), str(ROOT)]  # before this folder, which has a two_beams of its own
import two_beams

from dolfinx_mortar_al import contact, quasistatic

RULES = {
    "as shipped": {},
    "gaps trusted whatever their error": {"PATIENCE": 0.0},
    "all penetrated points close at once": {"DEEPEST": 0.0},
    "no weak points opened in the first solve": {"WEAK": 0.0},
    "all three off: plain semi-smooth Newton": {"PATIENCE": 0.0, "DEEPEST": 0.0, "WEAK": 0.0},
    "linear predictor without friction, too": {"MAX_ORDER": 1},
    "predictor of order 4 with friction, too": {"MAX_ORDER_WITH_FRICTION": 4},
    "ε the bulk's stiffness, not a tenth of it": {"SOFTER": 1.0},
    "points never held to a facet": {"RETURNS": 10**6},
}


def run(mesh: str, friction: str, changes: dict[str, float]) -> str:
    """Newton iterations and, where there were any, rejected steps."""
    module = {name: quasistatic if name.startswith("MAX_ORDER") else contact for name in changes}
    shipped = {name: getattr(module[name], name) for name in changes}
    for name, value in changes.items():
        setattr(module[name], name, value)
    try:
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(io.StringIO()) as bar:
            sys.argv = ["", "--friction", friction, "--cells", *mesh.split("x"), "--output", folder]
            history, *_ = two_beams.simulate(two_beams.options(), float(friction), Path(folder))
        rejected = bar.getvalue().count("rejected")
        return f"{history.column('newton_iterations').sum():.0f}" + (f" ({rejected} rejected)" if rejected else "")
    except quasistatic.StepFailure as failure:
        return f"fails: {str(failure).split(' with')[0]}"
    finally:
        for name, value in shipped.items():
            setattr(module[name], name, value)


if __name__ == "__main__":
    cases = [(mesh, friction) for mesh in ("40x4", "80x8") for friction in ("0", "0.3")]
    print("| rule | " + " | ".join(f"{mesh}, μ = {friction}" for mesh, friction in cases) + " |")
    print("|" + "---|" * (len(cases) + 1))
    for rule, changes in RULES.items():
        print(f"| {rule} | " + " | ".join(run(*case, changes) for case in cases) + " |", flush=True)
