"""The shipped targets that a program builds: the files are what the program makes, and it makes variants."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

import rpod_target
from rpod_schemas.config.base import load
from rpod_target.designs import Design, Envisat, Telecom, UpperStage, designs
from rpod_target.parameters import TargetParameters

SHIPPED = Path(rpod_target.__file__).parent / "targets"
MOST_BYTES = 250_000


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("designs")
    return {design.name: design.write(folder) for design in designs()}


@pytest.mark.parametrize("name", ["envisat-detailed", "telecom-satellite", "upper-stage"])
def test_the_shipped_files_are_what_the_program_writes(name: str, built: dict[str, Path]) -> None:
    """``python -m rpod_target.designs sim_sensor/rpod_target/targets`` writes them anew."""
    assert (SHIPPED / f"{name}.yaml").read_text() == built[name].read_text()
    shipped, made = (
        trimesh.load_scene(folder / f"meshes/{name}.glb") for folder in (SHIPPED, built[name].parent)
    )
    assert list(shipped.geometry) == list(made.geometry)
    for part, mesh in made.geometry.items():
        np.testing.assert_array_equal(shipped.geometry[part].faces, mesh.faces)
        np.testing.assert_allclose(shipped.geometry[part].vertices, mesh.vertices, atol=1e-5)
    assert (SHIPPED / f"meshes/{name}.glb").stat().st_size < MOST_BYTES


def extent_m(design: Design, *parts: str) -> np.ndarray:
    corners = [each.mesh.bounds for each in design.components if not parts or each.name in parts]
    return np.ptp(np.concatenate(corners), axis=0)


def test_the_designs_have_the_published_dimensions() -> None:
    envisat = Envisat(asar_tilt_deg=0.0, array_angle_deg=0.0).design()
    length, width, height = extent_m(envisat)
    assert (length, width) == pytest.approx((26.0, 10.0), abs=0.04)
    assert 4.5 < height < 5.5
    assert extent_m(envisat, "array-panels")[:2] == pytest.approx((14.0, 5.0), abs=0.05)
    assert extent_m(envisat, "asar-tiles")[:2] == pytest.approx((1.3, 10.0), abs=0.04)
    (ring,) = (each.mesh for each in Telecom().design().components if each.name == "launch-adapter")
    rim = ring.vertices[ring.vertices[:, 0] < ring.bounds[0, 0] + 1e-6, 1:]
    assert np.linalg.norm(rim, axis=1).max() == pytest.approx(1.194 / 2.0, abs=1e-6)
    assert extent_m(UpperStage().design(), "hydrogen-tank")[1:] == pytest.approx((4.0, 4.0), abs=0.05)


def test_a_variant_is_another_target(tmp_path: Path) -> None:
    design = Envisat(array_angle_deg=60.0).design()
    assert extent_m(design, "array-panels")[2] > 4.0
    parameters = load(TargetParameters, design.write(tmp_path))
    assert [part.name for part in parameters.parts] == [each.name for each in design.components]
    assert parameters.symmetries == ()
