"""What every command refuses: wrong usage (2), and errors in one line (1), which leave nothing."""

import pytest

SIMULATE = "simulate hand.ply -o x.h5"
IMAGE = "image sim.h5 -o x.h5"
FIT = "fit-hand volume.h5 -o x"
PLATE = "channels sim.h5 -o x.h5 --target plate"
HAND = "hand F -o x.ply"

WRONG_USAGE = [
    ("nonsense", "nonsense"),
    ("hand", "-o"),
    ("hand A --from A --to F -o x.toml", "--from: expected without POSE"),
    ("hand --to F -o x.toml", "--to: expected --from with it"),
    ("simulate -o x.h5", "MESH"),
    ("simulate hand.ply:1.5 -o x.h5", "[0, 1]"),
    (f"{SIMULATE} --alpha 1.5", "[0, 1]"),
    (f"{SIMULATE} --alpha rough", "expected a number in [0, 1] or PART=number, got 'rough'"),
    (f"{SIMULATE} --alpha 0 --alpha 1", "--alpha"),
    (f"{SIMULATE} --alpha a=0 --alpha a=1", "twice"),
    (f"{SIMULATE} --band 82:72:8", "FIRST below LAST"),
    (f"{SIMULATE} --band 72:82:0", "FIRST:LAST:STEPS"),
    (f"{SIMULATE} --band=72:nan:9", "expected FIRST:LAST:STEPS"),
    (f"{SIMULATE} --band=72e9:82:9", "got 7.2e+10 GHz; did you mean 7.2e+10 Hz (72 GHz)?"),
    (f"{SIMULATE} --band=72:82000:9", "got 82000 GHz; did you mean 82000 MHz (82 GHz)?"),
    (f"{SIMULATE} --reception-radius-mm=0.01", "from 0.1 to 1000 mm, got 0.01 mm"),
    (f"{SIMULATE} --frames 2", "--frames: expected --motion with it"),
    (f"{SIMULATE} --workers 0", "--workers"),
    (f"{SIMULATE} --array qar50 --workers 1", "expected an --array of clusters"),
    (f"{SIMULATE} --workers 2 --scheduler tcp://127.0.0.1:1", "--scheduler"),
    (f"{IMAGE} --x-mm 10:0:1", "--x-mm"),
    (f"{IMAGE} --z-mm 0:10:3", "0:9:3"),
    (f"{IMAGE} --z-mm=nan:1:1", "FIRST:LAST:STEP"),
    (f"{IMAGE} --x-mm=0:100:1e-320", "a step from 0.01 to 100000 mm, got 9.99989e-321 mm"),
    (f"{IMAGE} --x-mm=-0.1:0.1:0.001", "mean 0.001 cm (0.01 mm) or 0.001 m (1 mm)?"),
    (f"{IMAGE} --z-mm=300000", "of at most 100000 mm, got 300000 mm"),
    (f"{IMAGE} --all-echoes --z-mm 300", "--all-echoes: expected without --z-mm"),
    (f"{IMAGE} --iterations 3", "expected --method least-squares or sparse with it"),
    (f"{IMAGE} --method sparse --window hann", "--window: expected without --method"),
    (f"{IMAGE} --method sparse --damping-db 0", "--damping-db"),
    (f"{IMAGE} --method least-squares --sparsity-db=-20", "--sparsity-db"),
    (f"{IMAGE} --method sparse --dbsm", "--dbsm: expected without --method least-squares"),
    (f"{IMAGE} --method sparse --workers 1", "--workers: expected without --method"),
    (f"{IMAGE} --slice x", "--slice: expected --png with it"),
    ("image sim.h5", "expected a volume to write"),
    ("image sim.h5 volume.h5 --absolute -o x.h5", "--absolute: expected with a single capture"),
    ("image volume.h5 -o x.h5", "an image already"),
    ("image volume.h5 --png x.png --x-mm 0", "an image already"),
    ("compare volume.h5", "SIMULATED"),
    ("compare volume.h5 volume.h5 --x-mm 0:60:6", "no capture"),
    ("inspect sim.h5 --check --png x.png", "--png"),
    ("convert sim.h5 sim.h5 -o x.h5", "SOURCE"),
    ("convert sim.h5 -o x --to maroon --frame 0", "--frame"),
    ("convert recording -o x --all-frames --to maroon", "--all-frames"),
    ("convert recording -o x --all-frames --frame 0", "--all-frames"),
    ("clean sim.h5 -o x.h5", "nothing to do"),
    ("clean sim.h5 -o x.h5 --edge-mm 3", "--edge-mm: expected --gate-mm with it"),
    ("process recording -o x --keep-noisy", "--channels"),
    ("process recording -o x --scaling common", "--empty"),
    ("process recording -o x --bias", "--mesh"),
    ("process recording -o x --fit-shape", "--fit-hand"),
    (f"{FIT} --alpha 1.5", "expected a number in [0, 1] or 'fit', got '1.5'"),
    (f"{FIT} --mapping m.toml", "--mapping: expected --rig with it"),
    (f"{FIT} --rig hand.glb --girth 1.1", "--girth: expected without --rig"),
    (f"{FIT} --rig hand.glb --fit-shape", "--fit-shape: expected without --rig"),
    (f"{FIT} --rig hand.glb --hand left", "--hand: expected without --rig"),
    (f"{FIT} --x-mm 10:0:1", "--x-mm"),
    (f"{HAND} --turn-deg=1e308", "from -360 to 360 degrees"),
    (f"{PLATE} --radius-mm 3 --distance-mm 3", "--radius-mm: expected --target sphere with it"),
    (PLATE, "--distance-mm: --target plate needs it"),
    *((f"materials --band-ghz {band}", "--band-ghz") for band in ("72", "82:72", "72:82:1")),
    ("materials --band-ghz 72e9:82e9", "--band-ghz"),
]

ERRORS = [
    ("simulate none.ply -o x.h5", "none.ply: no such file; expected a mesh file"),
    ("simulate -o x.h5 -- --debug", "--debug"),
    (f"{SIMULATE} --unit mm", "unit='mm' & did you mean"),
    (f"{SIMULATE} --alpha nail=0", "palm & nail"),
    (f"{SIMULATE} --device abacus", "abacus"),
    (f"{SIMULATE} --samples-per-mm2=1e308", "fewer than 2^31 samples"),
    ("simulate hand.ply -o no/x.h5", "no/x.h5 & folder"),
    ("simulate hand.ply -o .", "folder"),
    ("simulate hand.ply -o hand.ply --force", "also an input"),
    ("hand J -o x.ply", "pose: & got 'J'"),
    ("hand F -o x.stp", ".ply & '.stp'"),
    (f"{HAND} --center-mm 300000 0 0", "got 300 m; did you mean 300 mm (0.3 m)"),
    ("image hand.ply -o x.h5", "hand.ply & got a mesh"),
    (f"{IMAGE} --png x.bmp", ".png & '.bmp'"),
    (f"{IMAGE} --dynamic-range-db 0", "positive"),
    (f"{IMAGE} --z-mm=0:1e5:0.01", "at most 2147483647 voxels"),
    ("image sim.h5 -o x.png --png x.png", "twice"),
    ("image sim.h5 --report x.png", ".html"),
    ("convert recording -o x.h5 --frame 5", "frame 5"),
    ("convert sim.h5 -o x.h5 --frame 1", "one file"),
    ("convert recording sim.h5 -o x --to maroon", "recording: expected a capture"),
    ("inspect none.h5", "none.h5"),
    ("compare volume.h5 volume.h5 --report x.pdf", ".html & '.pdf'"),
    (f"{FIT} --pose ff", "got 'ff' (did you mean 'F'?)"),
    (f"{FIT} --pose F,al", "got 'al' (did you mean 'all'?)"),
    (f"{FIT} --pose F,,L", "or the folder of an earlier fit, got ''"),
    (f"{FIT} --angle-std-deg 0", "--angle-std-deg: expected a positive number"),
    (f"{FIT} --pose none.toml", "none.toml: "),
    (f"{FIT} --pose recording", "recording: expected the folder of a fit"),
    (f"{FIT} --pose F,hand.ply", "pose: expected one of"),
    (f"{PLATE} --distance-mm=1e308", "a distance from 0.001 to 100 m"),
    (f"{PLATE} --distance-mm=0.3", "got 0.0003 m; did you mean 0.3 m?"),
    (
        "channels sim.h5 -o x.h5 --target=sphere --radius-mm=1e-320 --position-mm=0,0,300",
        "a radius from",
    ),
    (
        "channels sim.h5 -o x.h5 --target=corner --position-mm=0,0,300000",
        "did you mean 300 mm (0.3 m)",
    ),
    ("diagnose sim.h5 --expect-mm=1e308,0,300", "expected coordinates of at most 100 m"),
]


@pytest.mark.parametrize(
    ("status", "line", "part"),
    [*((2, *row) for row in WRONG_USAGE), *((1, *row) for row in ERRORS)],
)
def test_a_refusal_says_why_and_leaves_nothing(cli, place, status, line, part):
    before = sorted(place.iterdir())
    cli.fails(line, *part.split(" & "), status=status)
    assert sorted(place.iterdir()) == before
