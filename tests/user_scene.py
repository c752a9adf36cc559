"""A user's scene: a punch is pressed into a slab, both from one gmsh file, and dragged over it; CSV and ParaView files."""

import sys

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, output, quasistatic, read_msh

SLAB, PUNCH, SLAB_BOTTOM, SLAB_TOP, PUNCH_BOTTOM, PUNCH_TOP = 1, 2, 11, 12, 21, 22  # physical groups of the file
mesh, cells, facets = read_msh(sys.argv[1])
V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
u, top = fem.Function(V), fem.Constant(mesh, (0.0, 0.0))
dx = ufl.Measure("dx", mesh, subdomain_data=cells)
laws = [(materials.neo_hookean(E=young, nu=0.32), dx(tag)) for young, tag in ((100.0, SLAB), (1000.0, PUNCH))]
bcs = [
    fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, facets.find(tag)), V)
    for value, tag in ((np.zeros(2), SLAB_BOTTOM), (top, PUNCH_TOP))
]
contact = Contact(Surface(mesh, facets, PUNCH_BOTTOM), Surface(mesh, facets, SLAB_TOP), friction=0.3)
problem = ContactProblem(Body(u, laws, bcs=bcs), contacts=[contact])

stages = [
    quasistatic.Stage(top, to, increments) for to, increments in (((0, -0.1), 2), ((0.3, -0.1), 3), ((0.3, 0), 2))
]
columns = ["path", "x", "y", "force_x", "force_y", "newton_iterations", "wall_time"]
run = output.Run(problem, sys.argv[2], columns, {}, paraview=True, checkpoint=True)
for step in quasistatic.march(problem, stages, start=run.start, progress=True):
    (x, y), (fx, fy) = top.value, problem.pairs[0].force()
    run.record(step, step.path, path=step.path, x=x, y=y, force_x=fx, force_y=fy)
run.finish()
