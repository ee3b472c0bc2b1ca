# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Contact on paths: first contact, lost contact, jumps, restarts, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from problems import Cell
from touching import Touching, block, bump, compressible, plate

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.contact import sphere
from dolfinx_feti.loading import Checkpoint, Steps, follow_load, prestress, unload
from dolfinx_feti.output import FieldWriter


@pytest.mark.parametrize("gap", [1e-3, 0.1, 1.0])
@pytest.mark.parametrize("as_residual", [False, True], ids=["energy", "residual"])
def test_first_contact_of_a_body_that_nothing_holds(gap, as_residual):
    """A body without supports falls through a gap and rests on the plate."""
    touching = block(
        plate(3), cell=Cell.hexahedron, degree=1, pressure=0.1, as_residual=as_residual
    )
    touching.numbers["height"].value = -gap
    touching.problem.solve()
    least, most = touching.pressures()
    small(least / 0.1 - 1.0, 1e-8)
    small(most / 0.1 - 1.0, 1e-8)


def test_lost_contact_names_a_remedy():
    """If contact is lost and nothing else supports the body, the error recommends weak springs."""
    touching = block(plate(2), dim=2, cell=Cell.quadrilateral, degree=1, pressure=0.1)
    touching.problem.solve()
    touching.numbers["pressure"].value = -0.02
    with raises(ConvergenceError, "Without contact nothing supports the body.*spring_energy"):
        touching.problem.solve()


def thin(height):
    """Return a circle that is thinner than its way."""
    return lambda x: sphere(0.05, (0.5, 0.0))(x - ufl.as_vector([0.0, height]))


def test_jump_through_a_thin_tool_is_refused():
    """A step that jumps through a thin tool is refused, although both states have no contact."""
    touching = block(thin, dim=2, n=8, cell=Cell.quadrilateral)
    touching.numbers["height"].value = -0.1
    touching.problem.solve()
    touching.numbers["height"].value = 0.3
    with raises(ConvergenceError, "jumped through its tool"):
        touching.problem.solve()


def test_path_takes_short_steps_where_a_long_one_jumps():
    """A path shortens its steps where a longer one would jump through a thin tool."""
    touching = block(thin, dim=2, n=8, cell=Cell.quadrilateral)
    steps = follow(touching, -0.1, [-0.02], Steps(first=0.3, least=1e-3))
    agree(touching.contact.force()[1] > 0.0)
    small(touching.contact.penetration(), 1e-3 * np.sqrt(2.0) / 8)
    agree(steps[-1].load == -0.02)


def follow(touching: Touching, start: float, heights, steps: Steps, **options):
    """Move the tool along heights."""

    def set_height(height: float) -> None:
        touching.numbers["height"].value = height

    return follow_load(touching.problem, set_height, heights, steps, start=start, **options)


@pytest.mark.processes(1, 2, 3)
def test_restart_repeats_the_path(tmp_path):
    """A restarted path repeats multipliers, penalty and predictions of one run."""
    folder = COMM.bcast(tmp_path)
    lengths = Steps(first=0.01, least=1e-4)
    heights = [0.02, 0.05]
    whole = block(bump(3), n=2)
    follow(whole, 0.0, heights, lengths, checkpoint=Checkpoint(folder / "whole", COMM))
    first = block(bump(3), n=2)
    follow(first, 0.0, heights[:1], lengths, checkpoint=Checkpoint(folder / "parts", COMM))
    second = block(bump(3), n=2)
    checkpoint = Checkpoint(folder / "parts", COMM, restart=True)
    follow(second, 0.0, heights, lengths, checkpoint=checkpoint)
    equal(second.u.x.array, whole.u.x.array, 1e-12)
    equal(second.contact.force(), whole.contact.force(), 1e-12)


def test_multipliers_of_volume_and_contact_settle_together():
    """With volume multipliers too, each cell keeps its volume and the pressure is uniform."""
    touching = block(plate(2), dim=2, n=4, cell=Cell.triangle, pressure=0.1, volume_tolerance=1e-8)
    touching.problem.solve()
    least, most = touching.pressures()
    small(least / 0.1 - 1.0, 1e-6)
    small(most / 0.1 - 1.0, 1e-6)
    small(touching.problem.volume_changes[-1], 1e-8)


def test_contact_along_an_arc():
    """With the load as an unknown of an arc, the contact pressure equals it."""
    touching = block(
        plate(2), dim=2, n=3, cell=Cell.triangle, pressure=0.0, along_arc=True, as_residual=True
    )
    follow_load(touching.problem, lambda s: None, [0.1], Steps(first=0.05, least=1e-3))
    load = float(touching.numbers["pressure"].value)
    least, most = touching.pressures()
    agree(load > 0.01)
    small(least / load - 1.0, 1e-6)
    small(most / load - 1.0, 1e-6)


@pytest.mark.parametrize("path", [prestress, unload])
def test_paths_of_images_refuse_contacts(path):
    """Prestress and unload refuse contacts, whose pressure in an image is unknown."""
    touching = block(plate(2), dim=2, cell=Cell.quadrilateral, degree=1)
    mesh = touching.u.function_space.mesh
    G = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0, (2, 2))))
    G.interpolate(lambda x: np.tile(np.eye(2).reshape(4, 1), x.shape[1]))
    options = {"G": G} if path is prestress else {}
    with raises(ValueError, "pressure in an image is not known"):
        path(touching.problem, lambda t: None, [1.0], Steps(first=1.0, least=1.0), **options)


def test_pressure_is_written(tmp_path):
    """The contact pressure can be written, and the true pressure is lower on a stretched face."""
    touching = block(plate(3), n=2)
    touching.numbers["height"].value = 0.05
    touching.problem.solve()
    folder = COMM.bcast(tmp_path)
    with FieldWriter(folder / "pressure", [touching.contact.pressure]) as writer:
        writer.write(0.0)
    agree(writer.path.exists())
    true = touching.contact.true_pressure().x.array
    p = touching.contact.pressure.x.array
    agree(np.all(true < p))  # the face has grown


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"contacts": 1}, "put it in a list"),
        ({"contacts": ["x"]}, "give a Contact"),
        ({"contact_tolerance": 0.0}, "contact_tolerance is 0.0"),
    ],
    ids=["list", "kind", "tolerance"],
)
def test_bad_arguments(given, words):
    """Bad arguments of a contact are refused."""
    touching = block(plate(2), dim=2, cell=Cell.quadrilateral, degree=1)
    u = touching.u
    arguments = {"contacts": [touching.contact], **given}
    with raises(ValueError, words):
        NonlinearProblem(compressible(u, 1.0) * ufl.dx, u, **arguments)
