"""A plane, displacement-driven scene of `robustness_scenes` in GetFEM 5.4: a peer to count failures and iterations against.

    ./run python3 benchmarks/getfem_robustness.py scene.json mesh.npz

Mesh, materials, contactor, friction and increments are the scene's (`robustness.py --peer` writes both files). Contact is
GetFEM's large-sliding brick with ray tracing and a continuous vector multiplier of order 1, with the settings it converges
best with: augmentation 0.01 E/h of the softer body's E and the contactor's mean facet h, Newton without line search, contact
integrated with degree 8. Increments are not cut: a step that does not converge ends the run.

Standard output gets one line of JSON with what `robustness.py` records, standard error one line per step.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import getfem as gf
import numpy as np
from robustness_scenes import CONTACT, HELD, LOWER, UPPER, Scene, from_json, motion
from scipy.spatial import cKDTree

AUGMENTATION = 0.01  # times E/h; of 26 scenes 4 fail with it, 7 with 0.1, 5 with 0.001
CONTACT_DEGREE = 8
# all stresses are multiples of the softer body's E: GetFEM's residual test is absolute
SOLVER = ("max_iter", 60, "max_res", 1e-9, "lsolver", "mumps")
NO_LINE_SEARCH = ("lsearch", "simplest", "alpha max ratio", 1e30, "alpha min", 1.0)
# nodes of a cell in GetFEM's order, by kind and order
ORDER = {
    ("PK", 1): [0, 1, 2], ("PK", 2): [0, 5, 1, 4, 3, 2], ("QK", 1): [0, 1, 2, 3], ("QK", 2): [0, 4, 1, 5, 8, 6, 2, 7, 3],
}  # fmt: skip
GRADIENT = "(Id(2) + Grad_u_{0})"
NEO_HOOKEAN = "(g_{0}*({F} - Inv({F})') + l_{0}*log(Det({F}))*Inv({F})'):Grad_Test_u_{0}"


def body_mesh(scene: Scene, data: Any, body: int) -> Any:
    """The mesh of one body with its regions CONTACT and HELD."""
    kind, order = "PK" if scene.simplices else "QK", scene.geometry_order
    mesh, x = gf.Mesh("empty", 2), data["x"]
    for cell in data[f"cells_{body}"]:
        mesh.add_convex(gf.GeoTrans(f"GT_{kind}(2,{order})"), x[cell[ORDER[kind, order]]].T)
    mine = np.unique(data[f"cells_{body}"])
    number = mine[cKDTree(x[mine]).query(mesh.pts().T)[1]]  # of GetFEM's points among the nodes
    faces = mesh.outer_faces()
    nodes = [set(number[mesh.pid_in_faces(face[:, None])]) for face in faces.T]
    for region in (CONTACT, HELD):
        ends = [set(facet) for facet in data[f"facets_{body}_{region}"]]
        mesh.set_region(region, faces[:, [any(e <= face for e in ends) for face in nodes]])
    return mesh


def build(scene: Scene, data: Any) -> tuple[Any, Any, tuple[Any, ...]]:
    """The model; the displacement space of the upper body; a function that gives the contact force, and all that Python
    has to keep, as GetFEM frees what Python drops."""
    model, order, kind = gf.Model("real"), scene.order, "PK" if scene.simplices else "QK"
    unit = min(scene.lower.E, scene.upper.E)
    meshes = {body: body_mesh(scene, data, body) for body in (LOWER, UPPER)}
    degree = "IM_TRIANGLE({})" if scene.simplices else "IM_GAUSS_PARALLELEPIPED(2,{})"
    spaces = {body: gf.MeshFem(mesh, 2) for body, mesh in meshes.items()}
    rules = {body: gf.MeshIm(mesh, gf.Integ(degree.format(2 * order + 1))) for body, mesh in meshes.items()}
    for body, of in ((LOWER, scene.lower), (UPPER, scene.upper)):
        spaces[body].set_fem(gf.Fem(f"FEM_{kind}(2,{order})"))
        model.add_fem_variable(f"u_{body}", spaces[body])
        l, g = of.E / unit * of.nu / ((1 + of.nu) * (1 - 2 * of.nu)), of.E / unit / (2 * (1 + of.nu))
        if of.material == "neo_hookean":
            model.add_initialized_data(f"l_{body}", l)
            model.add_initialized_data(f"g_{body}", g)
            model.add_nonlinear_term(rules[body], NEO_HOOKEAN.format(body, F=GRADIENT.format(body)))
        else:
            model.add_initialized_data(f"material_{body}", [l, g])
            brick = ("SaintVenant Kirchhoff", f"u_{body}", f"material_{body}")
            model.add_finite_strain_elasticity_brick(rules[body], *brick)
        model.add_fem_data(f"old_{body}", spaces[body])  # at the last increment, for friction
    model.add_Dirichlet_condition_with_simplification(f"u_{LOWER}", HELD)
    model.add_fem_data("driven", spaces[UPPER])
    model.add_Dirichlet_condition_with_simplification(f"u_{UPPER}", HELD, "driven")

    contactor, target = (LOWER, UPPER) if scene.swap else (UPPER, LOWER)
    ends = data["x"][data[f"facets_{contactor}_{CONTACT}"]]
    r = AUGMENTATION / np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()
    thinnest = min(b.size[0] - b.size[1] if b.shape == "arc" else min(b.size) for b in (scene.lower, scene.upper))
    for name, value in {"r": r, "f": scene.friction, "alpha": 1.0}.items():
        model.add_initialized_data(name, value)
    multiplier = gf.MeshFem(meshes[contactor], 2)
    multiplier.set_fem(gf.Fem(f"FEM_{kind}(2,1)"))
    model.add_filtered_fem_variable("multiplier", multiplier, CONTACT)
    brick = model.add_integral_large_sliding_contact_brick_raytracing("r", 0.8 * thinnest, "f", "alpha")
    rule = gf.MeshIm(meshes[contactor], gf.Integ(degree.format(CONTACT_DEGREE)))
    old = [[f"old_{body}"] if scene.friction else [] for body in (contactor, target)]
    model.add_slave_contact_boundary_to_large_sliding_contact_brick(
        brick, rule, CONTACT, f"u_{contactor}", "multiplier", *old[0]
    )
    model.add_master_contact_boundary_to_large_sliding_contact_brick(
        brick, rules[target], CONTACT, f"u_{target}", *old[1]
    )

    def force() -> list[float]:
        """On the contactor, from its multiplier (N)."""
        parts = (gf.asm_generic(rule, 0, f"multiplier({k})", CONTACT, model) for k in (1, 2))
        return [unit * float(part) for part in parts]

    return model, spaces[UPPER], (force, meshes, spaces, rules, multiplier, rule)


def main() -> None:
    scene, data = from_json(json.loads(Path(sys.argv[1]).read_text())), np.load(sys.argv[2])
    gf.util_trace_level(0)
    gf.util_warning_level(0)
    start = perf_counter()
    result: dict[str, Any] = {"steps": [], "forces": [], "verdict": "right (unverified)", "reason": ""}
    model, space, (force, *_keep) = build(scene, data)
    X = space.basic_dof_nodes()[:, ::2].T  # u_x, u_y alternate
    for stage, of in enumerate(scene.stages):
        for step in range(1, of.increments + 1):
            for body in (LOWER, UPPER):
                model.set_variable(f"old_{body}", model.variable(f"u_{body}"))
            model.set_variable("driven", motion(scene, stage, step / of.increments, X)[0].ravel())
            try:
                iterations, success = model.solve(*SOLVER, *NO_LINE_SEARCH)
                why = "no convergence"
            except RuntimeError as error:
                iterations, success, why = 0, False, f"{error}"
            result["steps"].append([int(iterations), 0, of.slide])
            print(of.name, step, iterations, force(), file=sys.stderr, flush=True)
            if not success or not np.isfinite(model.variable(f"u_{UPPER}")).all():
                result |= {"verdict": "failed", "reason": f"{why} in step {step} of {of.name}"}
                break
        else:
            result["forces"].append(force())
            continue
        break
    print(json.dumps(result | {"seconds": round(perf_counter() - start, 2)}))


if __name__ == "__main__":
    main()
