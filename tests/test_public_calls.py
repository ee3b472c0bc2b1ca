# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Every public call of loading, output, diagnosis and comparison, on all processes together.

A new public name without an entry fails; what is written is written where no folder is yet, and
what cannot be written is an error on all processes.
"""

from __future__ import annotations

import csv
import dataclasses
import importlib
import inspect

import numpy as np
import pytest
import rooms
from collective import COMM, agree, equal, raises, small, whole
from pulled_body import Body

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, comparison, kinematics, loading, materials
from dolfinx_feti import output as out
from dolfinx_feti.diagnosis import advice, figures, run
from dolfinx_feti.mechanics.residual_stress import elastic_part


def same(value: object) -> None:
    """Require something that is printed alike on all processes."""
    agree(len(set(COMM.allgather(repr(value)))) == 1, value)


# -- the calls, by the names of what they call


def checkpoint(body: Body) -> None:
    body.checkpoint("state/here").write([body.u], {"load": 1.0})
    again = body.checkpoint("state/here", restart=True)
    again.read([body.u])
    same(again.record)
    for name in ("state/here", "file/state"):
        with raises(OSError, "another|cannot|directory"):
            body.checkpoint(name)


def follow_load(body: Body) -> None:
    same([(step.load, len(step.history)) for step in body.steps])
    agree([step.load for step in body.steps] == [0.1, 0.2])


def unload(body: Body) -> None:
    """The block is the image of itself under a load that it carried before."""
    body.set_load(0.0)
    body.u.x.array[:] = 0.0
    here = body.mesh.geometry.x.copy()
    steps = loading.unload(
        body.problem, body.set_load, [0.1], loading.Steps(first=0.1, least=0.1), state=[body.u]
    )
    same([step.load for step in steps])
    agree(COMM.allreduce(float(np.abs(body.mesh.geometry.x - here).max())) > 1e-3)
    body.mesh.geometry.x[:] = here


def prestress(body: Body) -> None:
    """The block stays where it is under a load, with G at points of quadrature."""
    u = dolfinx.fem.Function(body.u.function_space)
    element = basix.ufl.quadrature_element("tetrahedron", value_shape=(3, 3), degree=2)
    G = dolfinx.fem.Function(dolfinx.fem.functionspace(body.mesh, element))
    G.x.array[:] = np.tile(np.eye(3).ravel(), len(G.x.array) // 9)
    F = elastic_part(kinematics.deformation_gradient(u), G)
    load = dolfinx.fem.Constant(body.mesh, 0.0)
    psi = materials.neo_hookean(F.T * F, c=3.0, J=ufl.det(F)) + materials.volumetric(
        ufl.det(F), 10.0
    )
    energy = (psi * ufl.det(G) - load * u[0]) * ufl.dx
    problem = NonlinearProblem(energy, u, bcs=body.bcs, quadrature_degree=2, subdomains=6)

    def set_load(value: float) -> None:
        load.value = value

    first = loading.Steps(first=0.1, least=0.1)
    steps = loading.prestress(problem, set_load, [0.1], first, G=G, state=[u])
    same([step.load for step in steps])
    agree(not u.x.array.any() and len(steps) == 1)
    small(problem.residual_norm(), 1e-7 * steps[0].history[0].residual)


def write_history(body: Body) -> None:
    path = body.folder / "not/there/history.csv"
    loading.write_history(path, body.steps, COMM)
    with path.open(newline="") as file:
        agree(len(list(csv.DictReader(file))) == sum(len(step.all_steps) for step in body.steps))
    with raises(OSError, "cannot be written"):
        loading.write_history(body.folder / "file/history.csv", body.steps, COMM)


def field_writer(body: Body) -> None:
    stress = {"stress": kinematics.stress_magnitude(body.F)}
    with out.FieldWriter(body.folder / "new/fields", [body.u], stress) as writer:
        writer.write(0.0)
    agree(writer.path.exists())
    with raises(OSError, "cannot be written"):
        out.FieldWriter(body.folder / "file/fields", [body.u])


def writable_folder(body: Body) -> None:
    agree(out.writable_folder(body.folder / "a/b", COMM).is_dir())
    with raises(OSError, "cannot be written"):
        out.writable_folder(body.folder / "file", COMM)


def cell_values(body: Body) -> None:
    values = out.cell_values(ufl.SpatialCoordinate(body.mesh)[0], body.mesh)
    equal(whole(values).mean(), 0.5, 1e-12)


def create_patches(body: Body) -> None:
    equal(COMM.allreduce(body.patches.volumes.sum()), 1.0, 1e-12)


def recovered_field(body: Body) -> None:
    agree(body.stress.x.array.size and np.isfinite(body.stress.x.array).all())


def balanced_stress(body: Body) -> None:
    """The traction is constant in each cell of first order, and stays as it is."""
    stress, n = kinematics.cauchy_stress(body.psi, body.F), ufl.as_vector([1.0, 0.0, 0.0])
    both = (out.balanced_stress(stress, body.u, normal=n), stress)
    equal(*(out.cell_values(s[0, 0], body.mesh) for s in both), 1e-9)


def principal_values(body: Body) -> None:
    values = out.principal_values(body.stress).x.array.reshape(-1, 3)
    agree((np.diff(values, axis=1) >= 0.0).all())


def components(body: Body) -> None:
    found = out.components(body.stress, {"x": ufl.as_vector([1.0, 0.0, 0.0])})
    equal(found["x"].x.array, body.stress.x.array.reshape(-1, 9)[:, 0], 1e-12)


def layer_means(body: Body) -> None:
    x = ufl.SpatialCoordinate(body.mesh)[0]
    found = out.layer_means({"x": x}, body.patches, body.layers, {"all": 7})
    same(found)
    small(found["all"]["x"] - 0.5, 1e-12)


def assembled_system(body: Body) -> None:
    K, f, *_ = body.assembled
    agree(K.getSize()[0] == f.getSize() == body.linear.A.getSize()[0])


def measure(body: Body) -> None:
    same(body.assembled[2].iterations)


def relative_residual(body: Body) -> None:
    K, f, _, x = body.assembled
    small(comparison.relative_residual(K, f, x), 1e-10)


def relative_difference(body: Body) -> None:
    x, y = body.assembled[3], body.solver[4]
    small(comparison.relative_difference(y, x), 1e-5)  # rtol times a condition number


def create_solver(body: Body) -> None:
    """Solve with each of the solvers that are not FETI."""
    K, f, *_ = body.assembled
    for name in ("mumps", "gamg", "bddc"):
        ksp = comparison.create_solver(body.linear.A if name == "bddc" else K, name)
        x = f.duplicate()
        ksp.solve(f, x)
        agree(ksp.getConvergedReason() > 0, ksp.getConvergedReason())
        small(comparison.relative_residual(K, f, x), 1e-6)
        ksp.destroy()


def compare(body: Body) -> None:
    found = comparison.compare(body.linear, ["feti", "mumps"])
    same([(solved.solver, solved.converged) for solved in found.results])
    agree(all(solved.converged for solved in found.results), found)


def timed_solve(body: Body) -> None:
    same(body.solver[0].iterations)


def record_cost(body: Body) -> None:
    cost = comparison.record_cost(body.solver[1], (0.0, 1.0, 3.0), comparison.PeakMemory())
    same(cost)
    agree((cost.seconds_setup, cost.seconds_solve) == (1.0, 2.0), cost)


def peak_memory(body: Body) -> None:
    peak = comparison.PeakMemory()
    same((peak.mib(COMM), peak.mib_above_start(COMM)))


def diagnose(body: Body) -> None:
    for problem in (body.linear, body.problem):
        found = run.diagnose(
            problem.linear_system,
            problem.create_linear_solver,
            state=0.0,
            prefix="diagnosed_",
        )
        same(str(found))


def residual_shares(body: Body) -> None:
    _, _, A, b, x = body.solver
    small(np.linalg.norm(figures.residual_shares(A, b, x)) / b.norm(), 1e-7)


def figures_of(body: Body) -> figures.Figures:
    feti = body.solver[1].getPythonContext()
    return figures.collect_figures(feti.form, feti.report())


def collect_figures(body: Body) -> None:
    same(figures_of(body))


def advise(body: Body) -> None:
    same(advice.advise(figures_of(body), iterations=10, prefix="advised_"))


def motion(body: Body) -> None:
    small(loading.Motion(body.u, 1e-6).kinetic_energy(), 0.0)


def follow_time(body: Body) -> None:
    u = dolfinx.fem.Function(body.u.function_space)
    moving = loading.Motion(u, 1.0)
    energy = ufl.inner(ufl.grad(u), ufl.grad(u)) * ufl.dx + moving.inertia
    problem = NonlinearProblem(energy, u, quadrature_degree=2, subdomains=6)
    moving.velocity.x.array[:] = 1.0
    kept = {"checkpoint": body.checkpoint("moving/here")}
    steps = loading.TimeSteps(first=0.1, least=0.01)
    found = loading.follow_time(problem, moving, lambda t: None, [0.2], steps, state=[u], **kept)
    same([step.kinetic for step in found])
    agree(len(found) == 2 and np.allclose(u.x.array, 0.2))


CALLS = {
    "loading": {
        "Checkpoint": checkpoint,
        "Motion": motion,
        "follow_load": follow_load,
        "follow_time": follow_time,
        "prestress": prestress,
        "unload": unload,
        "write_history": write_history,
    },
    "output": {
        "FieldWriter": field_writer,
        "balanced_stress": balanced_stress,
        "cell_values": cell_values,
        "components": components,
        "create_patches": create_patches,
        "layer_means": layer_means,
        "principal_values": principal_values,
        "recovered_field": recovered_field,
        "writable_folder": writable_folder,
    },
    "diagnosis": {
        "advise": advise,
        "collect_figures": collect_figures,
        "diagnose": diagnose,
        "residual_shares": residual_shares,
    },
    "comparison": {
        "PeakMemory": peak_memory,
        "assembled_system": assembled_system,
        "compare": compare,
        "create_solver": create_solver,
        "measure": measure,
        "record_cost": record_cost,
        "relative_difference": relative_difference,
        "relative_residual": relative_residual,
        "timed_solve": timed_solve,
    },
}
ALL = [(room, name) for room, calls in CALLS.items() for name in calls]


def public(room: str) -> dict[str, object]:
    """What a room declares: in its own ``__all__``, or in those of its files."""
    folder = importlib.import_module(f"dolfinx_feti.{room}")
    if not hasattr(folder, "__all__"):
        names = [module.name for module in rooms.modules() if module.name.startswith(f"{room}.")]
        modules = [importlib.import_module(f"dolfinx_feti.{name}") for name in names]
        return {name: getattr(m, name) for m in modules for name in m.__all__}
    return {name: getattr(folder, name) for name in folder.__all__}


def works(thing: object) -> bool:
    """Whether it is a function, or a class that is not mere data."""
    return inspect.isfunction(thing) or (
        inspect.isclass(thing) and not dataclasses.is_dataclass(thing)
    )


@pytest.mark.serial
@pytest.mark.parametrize("room", CALLS)
def test_every_public_name_has_its_call(room):
    assert {name for name, thing in public(room).items() if works(thing)} == set(CALLS[room])


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    folder = COMM.bcast(tmp_path_factory.mktemp("calls"))
    if COMM.rank == 0:
        (folder / "file").write_text("in the way of a folder")
    COMM.Barrier()
    made = Body(folder)
    yield made
    for owned in (*made.assembled, *made.solver):
        if hasattr(owned, "destroy") and owned is not made.linear.A:
            owned.destroy()


@pytest.mark.parametrize(("room", "name"), ALL)
def test_call(body, room, name):
    CALLS[room][name](body)
