"""``clradar image`` of large grids and several captures: by parts, divided, resumed."""

from pathlib import Path

import numpy as np
import pytest
from interrupted import interrupted_at
from nightly import nightly
from quick_figures import draw_quickly, seek_nothing_else

import clradar
from clradar.cli.commands import image as images
from clradar.cli.commands.image import PartSteps
from clradar.imaging import fast
from clradar.jobs import Job
from measurement_io import check_file, open_capture, open_volume, save_capture

GRID = clradar.VoxelGrid.from_extent((-0.099, 0.099), (-0.03, 0.03), (0.9, 0.99), 3e-3)
OPTIONS = "--x-mm -99:99:3 --y-mm -30:30:3 --z-mm 900:990:3 -o"
PIECE_VOXELS = 23_000  # of 43 617: two pieces


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("clusters")
    along = np.linspace(-0.03, 0.03, 8)
    band = clradar.Waveform.sfcw(76e9, 80e9, 32)
    files = []
    for i, x_m in enumerate((-0.05, 0.05)):
        sides = ([[x + x_m, 0.03, 0] for x in along], [[0.03 + x_m, y, 0] for y in along])
        points_m = [[0.02, 0.01, 0.94], [-0.04, -0.03, 0.965]]
        files.append(folder / f"cluster_{i}.h5")
        array = clradar.AntennaArray(*sides)
        save_capture(files[-1], clradar.room_capture(array, band, [], points_m=points_m))
    return files


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten(monkeypatch)


def shorten(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(fast, "TILE_VOXELS", PIECE_VOXELS)
    patch.setattr(fast, "FEW_TERMS", 0)
    seek_nothing_else(patch)
    draw_quickly(patch)


@pytest.fixture(scope="module")
def wanted(captures: list[Path]) -> clradar.Volume:
    """The image of both captures, formed in memory."""
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch)
        return clradar.backproject([open_capture(path) for path in captures], GRID)


def test_the_parts_make_the_image_that_is_formed_in_memory(cli, captures, tmp_path, wanted):
    single = clradar.backproject(open_capture(captures[0]), GRID, check_grid=False)
    for some, want in ((captures, wanted), (captures[:1], single)):
        name = f"{len(some)}.h5"
        cli.ok(f"image {' '.join(map(str, some))} {OPTIONS} {name} --png {name}.png")
        assert check_file(name).ok
        volume = open_volume(name)
        np.testing.assert_array_equal(volume.data, want.data)
        assert volume.grid.same_voxels(GRID)
        assert volume.meta["capture"] == want.meta["capture"]
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["1.h5", "1.h5.png", "2.h5", "2.h5.png"]


@pytest.mark.parametrize(
    ("step", "last", "kept"), [("write", 3, 2), ("clear", 2, 2), *nightly([("write", 5, 3)])]
)
def test_an_interrupted_image_resumes(
    cli, captures, tmp_path, monkeypatch, wanted, step, last, kept
):
    """While the first piece is joined, at a part of the second, and while parts are removed."""

    def half(path: Path, _: object) -> None:
        path.with_name(f".{path.name}.0.tmp").write_bytes(b"half")  # as a kill leaves it

    def some(job: Job, names: list[str]) -> None:
        (job.folder / names[0] / "0000.npy").unlink()

    line = f"image {' '.join(map(str, captures))} {OPTIONS} out.h5"
    at = (images, "_write", last, half) if step == "write" else (Job, "clear", last, some)
    with interrupted_at(*at):
        assert cli(line).status == 130
    assert not Path("out.h5").exists()
    # Other options are refused, and what is done stays.
    cli.fails(f"{line} --window hann", "was begun with other settings", "window")
    made: list[tuple[int, int]] = []
    one_part = PartSteps.run
    monkeypatch.setattr(
        PartSteps, "run", lambda s, part, *more: made.append(part) or one_part(s, part, *more)
    )
    assert f"resumes with {kept} of 4 parts done before" in cli.ok(line).out
    assert len(made) == 4 - kept
    np.testing.assert_array_equal(open_volume("out.h5").data, wanted.data)
    assert [path.name for path in tmp_path.iterdir()] == ["out.h5"]


def test_a_grid_that_no_memory_holds(captures, monkeypatch):
    grid = clradar.VoxelGrid.from_extent((-1, 1), (-1, 1), (0.5, 1), 1e-3)
    capture = open_capture(captures[0])
    monkeypatch.setattr("clradar.imaging.memory._memory_bytes", lambda: 10**10)
    with pytest.raises(clradar.errors.ModelError, match=r"2001 x 2001 x 501 .* needs 18.1 GB"):
        clradar.backproject(capture, grid)
    with pytest.raises(clradar.errors.ModelError, match=r"whose image needs 48.1 GB"):
        clradar.backproject([capture, capture], grid)  # the sum is in double precision
