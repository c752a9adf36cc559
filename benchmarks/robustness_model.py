"""A scene of `robustness_scenes` as a problem of the package, and checks of its state that owe nothing to the package."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem, mesh
from numpy.typing import NDArray
from robustness_meshes import create
from robustness_scenes import CONTACT, HELD, LOADED, LOWER, UPPER, Scene, motion
from scipy.spatial import cKDTree

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, loads, materials, membrane
from dolfinx_mortar_al.versions import geometry_nodes
from meshes.two_membranes import EDGE

__all__ = ["Model", "export"]

Array = NDArray[np.float64]
FINENESS = {1: 32, 2: 10}  # lattice of samples on a facet of the target, by its dimension
SAMPLES = {1: 6, 2: 4}  # and of the contactor


class Model:
    """The problem of a scene, `set_load(stage)` for each stage's march, and checks of its state.

    `other_ε`: with augmentation parameters of the softer E over a length of 0.1 m instead of the package's own; `ε`: with
    this one (Pa/m); `integration` as in :class:`~dolfinx_mortar_al.Contact`.
    """

    def __init__(self, scene: Scene, other_ε: bool = False, integration: str = "gauss", ε: float | None = None) -> None:
        self.scene = scene
        self.mesh, self.cell_tags, self.facet_tags = create(scene)
        V = fem.functionspace(self.mesh, ("Lagrange", scene.order, (scene.dim,)))
        self.u, self._driven = fem.Function(V), fem.Function(V)
        self._load = fem.Constant(self.mesh, np.zeros(scene.dim))
        self.is_membrane = scene.family == "membranes"
        body = self._membranes() if self.is_membrane else self._bodies()
        self._bulk = fem.form(body.residual)
        sides = [Surface(self.mesh, *self._surface(body)) for body in (UPPER, LOWER)]
        contactor, target = reversed(sides) if scene.swap else sides
        if other_ε:
            ε = 10 * min(scene.lower.E, scene.upper.E) * (scene.lower.size[1] if self.is_membrane else 1.0)
        options = {"epsilon_normal": ε, "epsilon_tangential": ε}
        contacts = [Contact(contactor, target, friction=scene.friction, integration=integration, **options)]
        self.problem = ContactProblem(body, bcs=self._conditions(), contacts=contacts)
        self.pair = self.problem.pairs[0]

    # ---------------------------------------------------------------- the problem

    def _surface(self, body: int) -> tuple[Any, ...]:
        """What `Surface` takes after the mesh: tags, tag, and a membrane's side."""
        if self.is_membrane:
            return self.cell_tags, body, [0.0, 1.0 if body == LOWER else -1.0]
        return self.facet_tags, 10 * body + CONTACT

    def _membranes(self) -> Body:
        dx, u, p = ufl.Measure("dx", self.mesh, subdomain_data=self.cell_tags), self.u, self._load[1]
        sheets = [
            (membrane.neo_hookean_membrane(body.E, body.nu, body.size[1]), dx(tag))
            for tag, body in ((LOWER, self.scene.lower), (UPPER, self.scene.upper))
        ]
        push = [loads.membrane_pressure(u, p, [0, side], dx(tag)) for tag, side in ((LOWER, 1), (UPPER, -1))]
        return Body(u, sheets, external=sum(push))

    def _bodies(self) -> Body:
        scene, u = self.scene, self.u
        dx = ufl.Measure("dx", self.mesh, subdomain_data=self.cell_tags)
        ds = ufl.Measure("ds", self.mesh, subdomain_data=self.facet_tags)
        laws = [
            (getattr(materials, body.material)(body.E, body.nu), dx(tag))
            for tag, body in ((LOWER, scene.lower), (UPPER, scene.upper))
        ]
        load = None
        if scene.load == "weight":
            load = loads.dead_traction(u, self._load, dx(UPPER))
        elif scene.load == "dead":
            load = loads.dead_traction(u, self._load, ds(10 * UPPER + LOADED))
        elif scene.load == "follower":  # along the axis turned by −90°: down
            load = -loads.follower_force(u, self._load[1], ds(10 * UPPER + LOADED))
        return Body(u, laws, external=load)

    def _conditions(self) -> list[fem.DirichletBC]:
        """The lower body is clamped, the upper one driven by `_driven`, as the scene says."""
        scene, V, d = self.scene, self.u.function_space, self.scene.dim
        if self.is_membrane:
            ends = fem.locate_dofs_topological(V, d - 2, self.facet_tags.find(EDGE))
            return [fem.dirichletbc(np.zeros(d), ends, V)]
        clamped = fem.locate_dofs_topological(V, d - 1, self.facet_tags.find(10 * LOWER + HELD))
        self._held = fem.locate_dofs_topological(V, d - 1, self.facet_tags.find(10 * UPPER + HELD))
        bcs = [fem.dirichletbc(np.zeros(d), clamped, V)]
        if scene.held == "all":
            bcs.append(fem.dirichletbc(self._driven, self._held))
        elif scene.held == "x":
            bcs.append(self._component(0, self._held))
        if scene.load == "tip":
            end = fem.locate_dofs_topological(V, d - 1, self.facet_tags.find(10 * UPPER + LOADED))
            bcs[-1] = fem.dirichletbc(np.zeros(d), self._held, V)
            self._held = end[[np.argmax(V.tabulate_dof_coordinates()[end, 1])]]
            bcs.append(self._component(1, self._held))
        return bcs

    def _component(self, axis: int, blocks: Array) -> fem.DirichletBC:
        """Condition on one component at some nodes, its value kept in a function of the component's own space."""
        V = self.u.function_space
        W, parents = V.sub(axis).collapse()
        self._driven_component = fem.Function(W), axis
        child = np.searchsorted(np.ravel(parents), blocks * self.scene.dim + axis).astype(np.int32)
        return fem.dirichletbc(
            self._driven_component[0], [(blocks * self.scene.dim + axis).astype(np.int32), child], V.sub(axis)
        )

    def set_load(self, stage: int) -> Any:
        """The function of t ∈ [0, 1] that a march through the stage drives."""

        def set_(t: float) -> None:
            d, V = self.scene.dim, self.u.function_space
            X = V.tabulate_dof_coordinates()[:, :d]
            move, load = motion(self.scene, stage, t, X)
            self._load.value[:2] = load
            self._driven.x.array[:] = move.ravel()
            if hasattr(self, "_driven_component"):
                function, axis = self._driven_component
                function.x.array[:] = move[:, axis]

        return set_

    # ---------------------------------------------------------------- checks

    def balance(self) -> float | None:
        """Imbalance of the contact force and the bulk's internal forces at the free nodes of a body, as a share of the
        force; None where nothing is pressed or each body's contact surface has held nodes, whose share is not known."""
        force, d, V = self.pair.force(), self.scene.dim, self.u.function_space
        size = float(np.linalg.norm(force))
        if self.is_membrane or self.scene.family == "beams" or size < self.force_floor():
            return None
        internal = fem.assemble_vector(self._bulk).array.reshape(-1, d)
        lower = np.unique(V.dofmap.list[self.cell_tags.find(LOWER)])
        clamped = fem.locate_dofs_topological(V, d - 1, self.facet_tags.find(10 * LOWER + HELD))
        on_lower = internal[np.setdiff1d(lower, clamped)].sum(axis=0)
        return float(np.linalg.norm(on_lower - (force if self.scene.swap else -force))) / size

    def force_floor(self) -> float:
        """A force (N) that is next to nothing."""
        thinnest = min(min(body.size) for body in (self.scene.lower, self.scene.upper))
        return 1e-6 * min(self.scene.lower.E, self.scene.upper.E) * thinnest

    def penetration(self) -> float:
        """Deepest penetration of points of the contactor's facets into the target's deformed facets, beside its ends, as a
        share of the longer side's mean facet."""
        bodies = (LOWER, UPPER) if self.scene.swap else (UPPER, LOWER)
        dim = self.scene.dim - 1
        x = self._sample(bodies[0], SAMPLES[dim])[0].reshape(-1, dim + 1)
        y, normals, sizes = self._sample(bodies[1], FINENESS[dim])
        nearest = cKDTree(y.reshape(-1, dim + 1)).query(x)[1]
        r, n = x - y.reshape(-1, dim + 1)[nearest], normals.reshape(-1, dim + 1)[nearest]
        g = -np.einsum("ni,ni->n", r, n)
        aside = np.linalg.norm(r + g[:, None] * n, axis=1)
        seen = aside <= 1.5 * sizes.max() / FINENESS[dim]  # else beyond an end or edge
        longer = max(sizes.mean(), self._sample(bodies[0], 1)[2].mean())
        return float(np.max(g[seen], initial=0.0) / longer)

    def _sample(self, body: int, fineness: int) -> tuple[Array, Array, Array]:
        """Deformed points (nf, k, d) of a lattice on each facet, their outward unit normals, the facets' sizes (nf,) in m."""
        V, d = self.u.function_space, self.scene.dim
        cell, tdim = self.mesh.basix_cell(), self.mesh.topology.dim
        tags, tag, *side = self._surface(body)
        X = V.tabulate_dof_coordinates()[:, :d]
        found = []
        for entity in tags.find(tag):
            c, jacobian, corner = entity, np.eye(tdim), basix.geometry(cell)[0]
            kind, outward = cell, np.array(side[0] if side else 0.0)
            if not side:
                self.mesh.topology.create_connectivity(tdim - 1, tdim)
                self.mesh.topology.create_connectivity(tdim, tdim - 1)
                c = self.mesh.topology.connectivity(tdim - 1, tdim).links(entity)[0]
                local = list(self.mesh.topology.connectivity(tdim, tdim - 1).links(c)).index(entity)
                corner = basix.geometry(cell)[basix.topology(cell)[tdim - 1][local][0]]
                jacobian = basix.cell.facet_jacobians(cell)[local]
                kind = basix.cell.subentity_types(cell)[tdim - 1][local]
            lattice = basix.create_lattice(kind, fineness, basix.LatticeType.equispaced, True)
            points = corner + lattice @ jacobian.T
            table = V.element.basix_element.tabulate(1, points)[..., 0]
            dofs = V.dofmap.list[c]
            x = X[dofs] + self.u.x.array.reshape(-1, d)[dofs]
            if not side:
                outward = (table[0] @ X[dofs]).mean(axis=0) - X[dofs].mean(axis=0)
            reference = _normals(table, X[dofs], jacobian)
            normal = _normals(table, x, jacobian) * np.sign(reference @ outward)[:, None]
            found.append((table[0] @ x, normal / np.linalg.norm(normal, axis=1, keepdims=True), table[0] @ X[dofs]))
        x, n, reference_points = (np.array(part) for part in zip(*found, strict=True))
        return x, n, np.ptp(reference_points, axis=1).max(axis=1)


def export(scene: Scene, path: Path) -> None:
    """Write nodes, cells and the vertices of tagged facets of both bodies of a scene to an .npz file, for another code."""
    domain, cell_tags, facet_tags = create(scene)
    d, arrays = scene.dim, {}
    domain.topology.create_connectivity(d - 1, d)
    for body in (LOWER, UPPER):
        arrays[f"cells_{body}"] = geometry_nodes(domain)[cell_tags.find(body)]
        for kind in (CONTACT, HELD):
            facets = mesh.entities_to_geometry(domain, d - 1, facet_tags.find(10 * body + kind))
            arrays[f"facets_{body}_{kind}"] = facets[:, :d]
    np.savez(path, x=domain.geometry.x[:, :d], **arrays)


def _normals(table: Array, x: Array, jacobian: Array) -> Array:
    """(k, d) normals, not normalised, from basis functions tabulated to first order, nodes x and the facet's Jacobian."""
    a = np.einsum("tkn,ni,ts->ksi", table[1:], x, jacobian)
    return np.cross(a[:, 0], a[:, 1]) if x.shape[1] == 3 else np.stack([a[:, 0, 1], -a[:, 0, 0]], axis=1)
