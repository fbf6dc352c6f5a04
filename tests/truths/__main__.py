"""Write docs/validation.md, validation.csv and their figures: `make validation`."""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import clradar
from clradar.hand import hand_mesh
from truths import figures, invariants, measured, page, plates, rough, spheres, spread
from truths.page import Row

ROOT = Path(__file__).resolve().parents[2]
G = (0.1, 0.3, 1.0, 2.0, 3.0, 5.0, 10.0)
ANGLES_DEG = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
DENSITIES = (2.0, 4.0, 8.0, 16.0, 64.0)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m truths", description=__doc__)
    parser.add_argument("--docs", type=Path, default=ROOT / "docs", help="where to write")
    parser.add_argument("--only", help="this section alone; nothing is written but its figure")
    options = parser.parse_args()
    images = options.docs / "images" / "validation"
    images.mkdir(parents=True, exist_ok=True)
    tables: dict[str, list[Row]] = {}
    for name, section in SECTIONS.items():
        if options.only in (None, name):
            began = time.perf_counter()
            tables |= section(images)
            print(f"{name}: {time.perf_counter() - began:.1f} s", flush=True)
    for key, rows in tables.items():
        for row in rows:
            if options.only or not row.holds:
                print(f"{key}: {' | '.join(row.cells())}")
    if options.only is None:
        text, numbers = options.docs / "validation.md", options.docs / "validation.csv"
        text.write_text(page.filled(text.read_text("utf-8"), tables), encoding="utf-8")
        numbers.write_text(page.numbers(tables), encoding="utf-8")


def of_spheres(images: Path) -> dict[str, list[Row]]:
    sweeps = [
        spheres.sweep(measured.physical, a, skin, 41)
        for a in spheres.RADII_M
        for skin in (False, True)
    ]
    figures.spheres(sweeps, images / "spheres.png")
    closed, exact = spheres.rows(sweeps)
    return {"sphere-optics": closed, "sphere-mie": exact}


def of_plates(images: Path) -> dict[str, list[Row]]:
    distance = plates.over_distance(plates.DISTANCES_M)
    tilt = plates.over_tilt(measured.physical, plates.TILTS_DEG, plates.FAR_M)
    figures.over_distance(distance, tilt, images / "plates.png")
    rows = plates.rows(distance[::3], tilt, plates.plane(21))
    return {"plates": rows, "corners": plates.corners()}


def of_means(images: Path) -> dict[str, list[Row]]:
    means = [rough.mean_field(g, 100) for g in G]
    figures.means(means, images / "mean-field.png")
    return {"mean-field": rough.mean_rows(means), "contrast": rough.contrast_rows(means)}


def of_incoherent(images: Path) -> dict[str, list[Row]]:
    back = rough.incoherent(0.3e-3, ANGLES_DEG, 200, 24)
    across = rough.incoherent(0.1e-3, ANGLES_DEG, 200, 24, across=True)
    large = rough.incoherent(0.3e-3, ANGLES_DEG[-1:], 100, 24, side_m=0.08)
    named = {"back, h = 0.3 mm": back, "lit along the normal, h = 0.1 mm": across}
    figures.incoherent(named, images / "incoherent.png")
    (row,) = rough.speckle_rows(large)
    return {
        "incoherent-back": rough.incoherent_rows(back),
        "incoherent-across": rough.incoherent_rows(across),
        "speckle": [*rough.speckle_rows(back), replace(row, case=f"{row.case}, plate of 8 cm")],
    }


def of_energy(images: Path) -> dict[str, list[Row]]:
    rows = invariants.energy_rows(4000)
    return {"energy": [*rows, invariants.own_energy_row(rows[0].found)]}


def hand(material: str | clradar.Material) -> clradar.Scene:
    return clradar.Scene.from_mesh(hand_mesh("F"), material=material)


def of_reciprocity(images: Path) -> dict[str, list[Row]]:
    scenes = {
        "ball of rough skin": measured.ball(10e-3, 0.3, 1.6e-3, invariants.PALM),
        "hand F, metal": hand("metal"),
        "hand F, palm": hand("palm"),
    }
    return {"reciprocity": invariants.reciprocity_rows(scenes)}


def of_density(images: Path) -> dict[str, list[Row]]:
    imager = clradar.arrays.qar50()
    array = clradar.AntennaArray(imager.tx_m[::4], imager.rx_m[::4])
    errors = {
        name: invariants.density_errors(hand(material), DENSITIES, array, 32)
        for name, material in (("smooth metal", "metal"), ("palm", "palm"))
    }
    figures.density(DENSITIES, errors, images / "density.png")
    at = [DENSITIES.index(d) for d in (4.0, 8.0, 16.0)]
    row = Row("", 0, 0, invariants.DENSITY_BOUND_DB, digits=1, at_most=True)
    rows = [
        replace(row, case=f"{name}, {DENSITIES[i]:g} per mm²", found=e[i])
        for name, e in errors.items()
        for i in at
    ]
    return {"density": rows}


def of_spread(images: Path) -> dict[str, list[Row]]:
    cuts = {}
    for name, f in (("77 GHz", measured.band_hz(1)), ("72 to 82 GHz", measured.band_hz(32))):
        x, found = spread.cut(f)
        truth = np.mean([spread.factor(x, one) for one in f], axis=0)
        cuts[name] = (x, found, np.abs(truth))
    figures.spread(cuts, images / "spread.png")
    rows = [
        replace(r, case=f"{name}: {r.case}")
        for name, cut in cuts.items()
        for r in spread.rows(*cut)
    ]
    return {"spread": rows}


SECTIONS: dict[str, Callable[[Path], dict[str, list[Row]]]] = {
    "spheres": of_spheres,
    "plates": of_plates,
    "mean-field": of_means,
    "incoherent": of_incoherent,
    "energy": of_energy,
    "reciprocity": of_reciprocity,
    "density": of_density,
    "spread": of_spread,
}

if __name__ == "__main__":
    main()
