"""What commands say of how they saw a file: which side is up, what is clamped, whether an estimate explains it."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.app import estimate as estimate_command
from clothkit.app.agreement import EstimateAgreement, compare_estimate
from clothkit.app.describe import PlanRequest, notices
from clothkit.app.inputs import load_settings, read_input
from clothkit.app.options import observation_options
from clothkit.app.output import write_mesh
from clothkit.app.settings import AppConfig
from clothkit.cloth import voxels
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.silhouette import centre
from clothkit.cloth.topology import SQUARE
from clothkit.estimation.agreement import AgreementConfig
from clothkit.estimation.estimate import Alternatives
from clothkit.models.hypotheses import Hypotheses
from clothkit.observation.side import Stated
from clothkit.runtime.errors import InputError
from tests.app.conftest import run, succeed
from tests.observation.scenes import SCALE, folded, turned
from tests.observation.test_side import ABOVE, TOWEL
from tests.tiny import alarms_of

APP = AppConfig()


BASE = np.array([0.5, 0.0, 0.72])


@pytest.fixture
def base(here: Path) -> Path:
    """A towel on a table above the base of a robot, whose frame the points are in."""
    np.savez(here / "base.npz", points=TOWEL.points + BASE, cloth=TOWEL.cloth)
    return here / "base.npz"


def test_every_command_refuses_what_is_upside_down_and_takes_what_is_said_of_up(here: Path, base: Path) -> None:
    np.save(here / "goal.npy", SQUARE.flat())
    for command in (
        ("estimate", base),
        ("plan", "--state", base, "--goal", "goal.npy", "--steps", 1),
        ("plan", "--state", "goal.npy", "--goal", base, "--steps", 1),
        ("view", "--state", base, "--goal", "goal.npy", "--no-browser"),
    ):
        wrong = run(*command)
        assert wrong.exit_code == 1
        assert "base.npz: the cloth lies on the side of the table that the origin" in wrong.stderr
        assert "--up" in wrong.stderr
    assert not list(here.glob("*.obj"))
    succeed("estimate", base, "--up", 0, 0, 1, "--out", "up.obj")
    succeed("estimate", base, "--viewpoint", *(ABOVE + BASE), "--out", "viewpoint.obj")
    one, other = ((here / f"{name}.obj").read_text().splitlines() for name in ("up", "viewpoint"))
    # The first line tells the file's name.
    assert one[1:] == other[1:]


def test_what_is_known_of_up_comes_from_params_unless_options_say_otherwise() -> None:
    app = AppConfig(up=(0.0, 0.0, 1.0), viewpoint=(0.0, 0.0, 2.0), y_up=True)
    assert observation_options(app, side=None, table=None).stated == Stated((0.0, 0.0, 1.0), (0.0, 0.0, 2.0))
    other = observation_options(app, side=None, table=None, up=(1.0, 0.0, 0.0), viewpoint=(3.0, 0.0, 0.0))
    assert other.stated == Stated((1.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    assert other.y_up
    # A table that is given has a normal of its own.
    assert observation_options(app, side=None, table=(0.0, 0.0, 1.0, 0.0)).stated.up is None
    assert observation_options(APP, side=None, table=None, y_up=True).stated.up == (0.0, 1.0, 0.0)
    assert observation_options(APP, side=None, table=(0.0, 0.0, 1.0, 0.0), y_up=True).stated.up is None
    with pytest.raises(InputError, match="--up: expected a direction, found 0 0 0"):
        observation_options(APP, side=None, table=None, up=(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="--viewpoint: expected three finite numbers, found nan 0 1"):
        observation_options(APP, side=None, table=None, viewpoint=(np.nan, 0.0, 1.0))


def test_a_mesh_with_y_up_is_refused_and_turned_when_told(here: Path) -> None:
    metres = folded(angle=0.4).astype(float) * SCALE
    # x to the right, y up, z towards the viewer.
    write_mesh(here / "y_up.obj", np.stack([metres[..., 0], metres[..., 2], -metres[..., 1]], axis=-1))
    write_mesh(here / "z_up.obj", metres)
    rows = (here / "y_up.obj").read_text().splitlines()
    # Without its first face it is no grid, and is seen from above.
    first = next(k for k, row in enumerate(rows) if row.startswith("f "))
    (here / "y_up_surface.obj").write_text("\n".join(rows[:first] + rows[first + 1 :]) + "\n")
    for name in ("y_up.obj", "y_up_surface.obj"):
        wrong = run("estimate", name, "--out", "mesh.obj")
        assert wrong.exit_code == 1
        assert "stands upright" in wrong.stderr
        assert "--y-up" in wrong.stderr
    told = read_input(str(here / "y_up.obj"), observation_options(APP, side=None, table=None, y_up=True))
    plain = read_input(str(here / "z_up.obj"), observation_options(APP, side=None, table=None))
    np.testing.assert_array_equal(told.observation.voxels, plain.observation.voxels)
    surface = read_input(str(here / "y_up_surface.obj"), observation_options(APP, side=None, table=None, y_up=True))
    assert (surface.observation.voxels != plain.observation.voxels).sum() < 0.05 * plain.observation.voxels.sum()


def test_what_is_clamped_is_said_and_stands_in_the_plan(here: Path) -> None:
    thick = folded() * np.float32([1, 1, 7])
    write_mesh(here / "thick.obj", thick.astype(float) * SCALE)
    said = run("estimate", "thick.obj", "--out", "mesh.obj")
    assert said.exit_code == 0
    (notice,) = (line for line in said.stderr.splitlines() if line.startswith("notice: "))
    assert "thick.obj: " in notice
    assert "% of the cloth lies higher than nets see, whose viewport ends 36 mm above the table" in notice
    seen = read_input("thick.obj", observation_options(APP, side=None, table=None))
    unknown = EstimateAgreement(0.2, 0.1, False, "thick.obj: the estimate does not explain what was seen")
    request = PlanRequest(seen, seen, SQUARE.flat(), None, (0.4, 0.4), 0.002, 0, "table", (unknown, None))
    # Once, although state and goal are one file.
    assert notices(request) == [notice.removeprefix("notice: "), unknown.sentence]


def test_estimate_tells_what_it_covers_and_whether_it_explains(here: Path, files: Path) -> None:
    half = folded(along=0.0)
    perfect = one_of(half)

    np.save(here / "half.npy", np.asarray(voxels.observe(half)))
    write_mesh(here / "across.obj", turned(half, np.pi / 2).astype(float) * SCALE)
    with mock.patch.object(estimate_command, "alternatives_of", perfect):
        first, second = succeed("estimate", "half.npy", "--out", "mesh.obj").splitlines()
        wrong = succeed("estimate", "across.obj", "--out", "mesh.obj").splitlines()
    # Half of 40 x 40 cm, and a little for the bend and for pixels at the border; voxels are counted whole.
    estimate, observed = (float(part.split(" cm²")[0].split()[-1]) for part in first.split("covers")[1].split(","))
    assert estimate == pytest.approx(812, abs=30)
    assert estimate < observed < 1.25 * estimate
    assert second == "half.npy: the estimate explains what was seen (silhouette IoU 1.00, height IoU 1.00)"
    # Of two halves of a square that cross, a quarter of it is in both, and three quarters in either.
    assert wrong[1].startswith("warning: across.obj: the estimate does not explain what was seen (silhouette IoU 0.3")
    assert "expected at least 0." in wrong[1]


def test_all_shapes_that_may_be_seen_are_written_with_their_probabilities(here: Path, files: Path) -> None:
    half, other = folded(along=0.0), folded(along=0.0) * np.float32([1, -1, 1])
    np.save(here / "half.npy", np.asarray(voxels.observe(half)))
    several = one_of(half, other, SQUARE.flat(), probability=(0.7, 0.26, 0.04))
    with mock.patch.object(estimate_command, "alternatives_of", several):
        said = succeed("estimate", "half.npy", "--out", "mesh.ply").splitlines()
    assert said[0] == "half.npy: may show 2 shapes, which have the probabilities 70 %, 26 %"
    assert [line.split(":")[0] for line in said[1:3]] == ["mesh.ply", "mesh.2.ply"]
    for name, mesh in (("mesh", half), ("mesh.2", other)):
        with np.load(here / f"{name}.sigma.npz") as arrays:
            np.testing.assert_allclose(centre(arrays["mesh"] / SCALE), centre(mesh), atol=1e-5)
    assert not (here / "mesh.3.ply").exists()


def one_of(*meshes: np.ndarray, probability: Sequence[float] = (1.0,)) -> Callable[..., Alternatives]:
    """An estimator that always answers with these shapes, and is sure to a hundredth."""
    mean = np.stack(meshes)[None]
    found = Hypotheses(ProbabilisticMesh(mean, np.full_like(mean, 0.01)), jnp.array([probability]))
    return lambda *_: Alternatives(found, jnp.asarray(mean))


def test_what_the_net_has_never_seen_is_told(here: Path) -> None:
    np.save(here / "flat.npy", SQUARE.flat())
    settings = load_settings(Path("data"))
    assert settings.alarms is None
    for strangest, thickness, doubts in (
        (100.0, 0.002, ()),
        (0.1, 0.002, ("the net has seen nothing like it (strangeness ",)),
        (100.0, 0.02, ("the net has seen no cloth of", "mm thick, but of")),
        (0.1, 0.02, ("strangeness", "and the net has seen no cloth of")),
    ):
        seen = read_input("flat.npy", observation_options(APP, side=None, table=None, thickness=thickness))
        known = settings._replace(alarms=alarms_of(strangest=strangest))
        found = compare_estimate(seen, SQUARE.flat(), known)
        assert found.explains
        assert found.known == found.reliable == (not doubts)
        assert ("can't be relied on" in found.sentence) == bool(doubts)
        assert all(doubt in found.sentence for doubt in doubts)
        assert found.strangeness is not None
        assert 0.1 < found.strangeness < 100


def test_thresholds_come_with_the_nets_and_may_be_overridden(here: Path, tmp_path: Path) -> None:
    np.save(here / "flat.npy", SQUARE.flat())
    settings = load_settings(Path("data"))
    seen = read_input("flat.npy", observation_options(settings.app, side=None, table=None))
    lower = SQUARE.flat() * np.float32([0.9, 1, 1])
    strict = alarms_of(strangest=100.0)._replace(least=AgreementConfig(silhouette=0.97, heights=0.1))
    assert not compare_estimate(seen, lower, settings._replace(alarms=strict)).explains
    own = dataclasses.replace(settings.app, agreement=AgreementConfig(silhouette=0.5, heights=0.1))
    assert compare_estimate(seen, lower, settings._replace(alarms=strict, app=own)).explains


def test_the_least_agreement_is_a_setting(here: Path) -> None:
    np.save(here / "flat.npy", SQUARE.flat())
    assert np.abs(centre(SQUARE.flat())).max() < 0.01
    settings = load_settings(Path("data"))
    seen = read_input("flat.npy", observation_options(settings.app, side=None, table=None))
    lower = SQUARE.flat() * np.float32([0.9, 1, 1])
    found = compare_estimate(seen, lower, settings)
    assert found.silhouette_iou == pytest.approx(found.height_iou)
    assert 0.85 < found.silhouette_iou < 0.95
    assert found.explains
    strict = AppConfig(agreement=AgreementConfig(silhouette=0.97, heights=0.1))
    assert not compare_estimate(seen, lower, settings._replace(app=strict)).explains
