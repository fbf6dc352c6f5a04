"""Write docs/validation.md, validation.csv and their figures: `make validation`."""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import clradar
from clradar.hand import hand_mesh
from truths import gaussian, invariants, measured, optics, page, plates, rough, spheres, spread
from truths.page import Row
from truths.rough import Incoherent, Mean, contrast
from truths.spheres import Sweep

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
    draw_spheres(sweeps, images / "spheres.png")
    closed, exact = spheres.rows(sweeps)
    return {"sphere-optics": closed, "sphere-mie": exact}


def of_plates(images: Path) -> dict[str, list[Row]]:
    distance = plates.over_distance(plates.DISTANCES_M)
    tilt = plates.over_tilt(measured.physical, plates.TILTS_DEG, plates.FAR_M)
    draw_over_distance(distance, tilt, images / "plates.png")
    rows = plates.rows(distance[::3], tilt, plates.plane(21))
    return {"plates": rows, "corners": plates.corners()}


def of_means(images: Path) -> dict[str, list[Row]]:
    means = [rough.mean_field(g, 100) for g in G]
    draw_means(means, images / "mean-field.png")
    return {"mean-field": rough.mean_rows(means), "contrast": rough.contrast_rows(means)}


def of_incoherent(images: Path) -> dict[str, list[Row]]:
    back = rough.incoherent(0.3e-3, ANGLES_DEG, 200, 24)
    across = rough.incoherent(0.1e-3, ANGLES_DEG, 200, 24, across=True)
    large = rough.incoherent(0.3e-3, ANGLES_DEG[-1:], 100, 24, side_m=0.08)
    named = {"back, h = 0.3 mm": back, "lit along the normal, h = 0.1 mm": across}
    draw_incoherent(named, images / "incoherent.png")
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
    draw_density(DENSITIES, errors, images / "density.png")
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
    draw_spread(cuts, images / "spread.png")
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

# ---- figures


TRUTH = {"color": "black", "lw": 1.2}
FOUND = {"color": "tab:red", "marker": "o", "ms": 3.5, "lw": 0}


def new(n: int, width: float = 3.2, height: float = 2.8) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width * n, height), facecolor="white", layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, n)).tolist()
    for a in axes:
        a.grid(alpha=0.3)
        a.tick_params(labelsize=8)
    return figure, axes


def save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=90, metadata={"Software": None})


def draw_spheres(sweeps: list[Sweep], path: Path) -> None:
    radii = sorted({s.radius_m for s in sweeps})
    figure, axes = new(len(radii), 2.3, 2.7)
    colours = {"metal": "tab:blue", "skin": "tab:orange"}
    for s in sweeps:
        a = axes[radii.index(s.radius_m)]
        colour, x = colours[s.material], s.frequencies_hz / 1e9
        a.plot(x, s.mie, color=colour, lw=1.4, label=f"{s.material}: Mie")
        a.plot(x, s.optics, color=colour, lw=1, ls="--", label="physical optics, closed form")
        a.plot(x, s.found, color=colour, lw=0, marker="o", ms=2.5, label="clradar")
        a.set_title(f"a = {1e3 * s.radius_m:g} mm", fontsize=9)
        a.set_xlabel("GHz", fontsize=8)
    axes[0].set_ylabel("dB over πa²|Γ₀|²", fontsize=8)
    for a in axes[1:]:
        low, high = a.get_ylim()
        middle = (low + high) / 2
        a.set_ylim(min(low, middle - 0.5), max(high, middle + 0.5))
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=7)
    save(figure, path)


def draw_over_distance(table: np.ndarray, tilt: np.ndarray, path: Path) -> None:
    figure, (a, b) = new(2, 4.2)
    k = measured.wavenumber(measured.band_hz(1))
    sides = (plates.SIDE_M, plates.SIDE_M)
    z = np.geomspace(table[0, 0], table[-1, 0], 300)
    exact = [plates.sigma_db(optics.rectangle(r, sides, k)[0], r) for r in z]
    a.plot(z, exact, label="Fresnel integrals", **TRUTH)
    a.plot(z, 10 * np.log10(np.pi * z**2), ls=":", color="grey", label="πR²: plane")
    far = 10 * np.log10(optics.tilted_rectangle_m2(sides, np.array(0.0), k)[0])
    a.axhline(far, ls="--", color="grey", lw=1, label="4πA²/λ²: far away")
    a.plot(table[:, 0], table[:, 1], label="clradar", **FOUND)
    a.set(xscale="log", xlabel="distance (m)", ylabel="dBsm", ylim=(-22, 10))
    angle = np.linspace(0, tilt[-1, 0], 600)
    lobes = optics.tilted_rectangle_m2(sides, np.radians(angle), k)
    b.plot(angle, 10 * np.log10(lobes + 1e-9), label="4π(A cos sinc/λ)²", **TRUTH)
    b.plot(tilt[:, 0], tilt[:, 1], label="clradar", **FOUND)
    b.set(xlabel="tilt (degrees), at 10 m", ylabel="dBsm", ylim=(-50, 10))
    for axes in (a, b):
        axes.legend(fontsize=7)
    save(figure, path)


def draw_means(found: list[Mean], path: Path) -> None:
    figure, (a, b) = new(2, 4.2)
    g = np.geomspace(0.08, 12, 100)
    a.plot(g, gaussian.coherent(g), label="exp(-g/2)", **TRUTH)
    size = [abs(m.relative.mean()) for m in found]
    at = [m.g for m in found]
    a.errorbar(at, size, [3 * m.error for m in found], fmt="o", ms=3.5, color="tab:red", capsize=2,
               lw=1, label="clradar, 3 standard errors")  # fmt: skip
    a.set(xscale="log", yscale="log", ylim=(2e-3, 2), xlabel="g = h² q²", ylabel="|mean field|")
    b.plot(at, [m.contrast for m in found], label="Gaussian heights, Goodman", **TRUTH)
    n = len(found[0].relative)
    error = [3 * (m.contrast + m.contrast**2) / np.sqrt(n) for m in found]
    b.errorbar(at, [contrast(m.relative) for m in found], error, fmt="o", ms=3.5, color="tab:red",
               capsize=2, lw=1, label="clradar, 3 standard errors")  # fmt: skip
    b.axhline(1, ls=":", color="grey")
    b.set(xscale="log", xlabel="g", ylabel="speckle contrast", ylim=(0, 1.6))
    for axes in (a, b):
        axes.legend(fontsize=7)
    save(figure, path)


def draw_incoherent(found: dict[str, list[Incoherent]], path: Path) -> None:
    figure, (a,) = new(1, 5.0, 3.2)
    for (name, rows), colour in zip(found.items(), ("tab:blue", "tab:orange"), strict=False):
        angle = [i.angle_deg for i in rows]
        a.plot(
            angle, [i.endless for i in rows], ls="--", lw=1, color=colour, label=f"{name}: series"
        )
        a.plot(angle, [i.finite for i in rows], lw=1.4, color=colour, label="plate with its edges")
        a.errorbar(angle, [i.found for i in rows], [3 * i.error_db for i in rows], fmt="o", ms=3.5,
                   color=colour, capsize=2, lw=1, label="clradar, 3 standard errors")  # fmt: skip
    a.set(xlabel="angle (degrees)", ylabel="incoherent power per area (dB)")
    a.legend(fontsize=7)
    save(figure, path)


def draw_density(densities: tuple[float, ...], errors: dict[str, np.ndarray], path: Path) -> None:
    figure, (a,) = new(1, 5.0, 3.0)
    for name, e in errors.items():
        a.plot(densities[:-1], e, marker="o", ms=3.5, lw=1.2, label=name)
    a.axhline(-38, ls=":", color="grey")
    a.set(
        xscale="log",
        xlabel="points per mm²",
        ylabel=f"image against {densities[-1]:g} per mm² (dB)",
    )
    a.legend(fontsize=7)
    save(figure, path)


def draw_spread(cuts: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]], path: Path) -> None:
    figure, axes = new(len(cuts), 4.2)
    for a, (name, (x, found, truth)) in zip(axes, cuts.items(), strict=True):
        a.plot(1e3 * x, 20 * np.log10(truth + 1e-4), label="array factor", **TRUTH)
        a.plot(1e3 * x[::5], 20 * np.log10(found[::5] + 1e-4), label="clradar", **FOUND)
        a.set(xlabel="x (mm)", ylabel="dB", ylim=(-50, 2))
        a.set_title(name, fontsize=9)
        a.legend(fontsize=7)
    save(figure, path)


if __name__ == "__main__":
    main()
