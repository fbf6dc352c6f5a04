"""What is in the tabs of the panel."""

from __future__ import annotations

from collections.abc import Callable

from clradar.backproject import METHODS, WINDOWS
from clradar.errors import CompareError, ModelError
from clradar.model import Capture, VoxelGrid
from clradar.view.beside import MATERIALS
from clradar.view.channels import pair_drawings
from clradar.view.controls import Controls, assign
from clradar.view.grids import extents_mm, grid_mm
from clradar.view.pictures import depth_drawing, difference_drawing, projection_drawing
from clradar.view.session import Session, Shown
from clradar.view.slices import slice_drawings, strongest_m


class PicturesTab:
    """Maximum projection, depth map, and beside a second image the difference in depth."""

    def __init__(self, controls: Controls) -> None:
        self._drawings = controls.html()

    def show(self, shown: Shown) -> None:
        image, at_m = shown.chosen.picture.image, shown.wish.at_m
        marked_mm = None if at_m is None else (1e3 * at_m[0], 1e3 * at_m[1])
        drawn = projection_drawing(image, marked_mm) + depth_drawing(image, marked_mm)
        if shown.second is not None:
            try:
                drawn += difference_drawing(shown.first.picture.image, shown.second.picture.image)
            except CompareError:
                drawn += "No difference in depth: the two volumes are on different voxels."
        assign(self._drawings, "content", drawn)


class SlicesTab:
    """Slices through a place that is typed here or clicked in the scene."""

    def __init__(self, controls: Controls, session: Session) -> None:
        gui = controls.gui
        self._place = gui.add_vector3("x, y, z (mm)", (0.0, 0.0, 0.0), step=0.1)
        controls.on(self._place, lambda: session.change(at_m=self._typed_m()))
        strongest = gui.add_button("To the strongest voxel")
        strongest.on_click(lambda _: session.change(at_m=None))
        gui.add_markdown("A click on a point in the scene, or on a picture, puts the slices there.")
        self._drawings = controls.html()

    def show(self, shown: Shown) -> None:
        volume = shown.chosen.volume
        at_m = shown.wish.at_m or strongest_m(volume)
        assign(self._place, "value", tuple(round(1e3 * value, 3) for value in at_m))
        drawn = slice_drawings(volume, at_m, shown.wish.dynamic_range_db)
        assign(self._drawings, "content", "".join(drawn))

    def _typed_m(self) -> tuple[float, float, float]:
        x, y, z = self._place.value
        return 1e-3 * x, 1e-3 * y, 1e-3 * z


class ChannelsTab:
    """Channel data of all pairs, and of a chosen one."""

    def __init__(self, controls: Controls, session: Session, capture: Capture) -> None:
        gui, array = controls.gui, capture.array
        # The end of a slider has to be above its begin.
        self._tx = gui.add_slider("Tx", 0, max(1, array.n_tx - 1), 1, session.wish.tx)
        self._rx = gui.add_slider("Rx", 0, max(1, array.n_rx - 1), 1, session.wish.rx)
        controls.on(self._tx, lambda: session.change(tx=int(self._tx.value)))
        controls.on(self._rx, lambda: session.change(rx=int(self._rx.value)))
        self._drawings = controls.html()
        self._shown: tuple[Capture, int, int] | None = None

    def show(self, shown: Shown) -> None:
        content, tx, rx = shown.content, shown.wish.tx, shown.wish.rx
        if not isinstance(content, Capture) or self._is_shown(content, tx, rx):
            return
        self._shown = (content, tx, rx)
        for control, n in ((self._tx, content.array.n_tx), (self._rx, content.array.n_rx)):
            assign(control, "max", max(1, n - 1))
        assign(self._drawings, "content", "".join(pair_drawings(content, tx, rx)))

    def _is_shown(self, capture: Capture, tx: int, rx: int) -> bool:
        return self._shown is not None and self._shown[0] is capture and self._shown[1:] == (tx, rx)


def add_imaging(
    controls: Controls, session: Session, grid: VoxelGrid, refuse: Callable[[str], None]
) -> None:
    """Add controls of grid, method and window that captures are imaged with."""
    gui, wish = controls.gui, session.wish
    with gui.add_folder("Image again"):
        step_mm = round(1e3 * float(grid.spacing_m[0]), 6)
        step = gui.add_number("Voxel size (mm)", step_mm, min=0.1, step=0.1)
        ends = [
            gui.add_vector2(f"{name} (mm)", ends_mm, step=1.0)
            for name, ends_mm in zip("xyz", extents_mm(grid), strict=True)
        ]
        method = gui.add_dropdown("Method", METHODS, initial_value=wish.method)
        window = gui.add_dropdown("Window", WINDOWS, initial_value=wish.window)

    def again() -> None:
        try:
            x_mm, y_mm, z_mm = (control.value for control in ends)
            wished = grid_mm(x_mm, y_mm, z_mm, step.value)
        except ModelError as error:
            refuse(str(error))
            return
        session.change(grid=wished, method=method.value, window=window.value)

    for control in (step, *ends, method, window):
        controls.on(control, again)


def add_simulation(controls: Controls, session: Session) -> None:
    """Add controls of what the mesh is simulated with."""
    gui, wish = controls.gui, session.wish
    with gui.add_folder("Simulate again"):
        alpha = gui.add_slider("\N{GREEK SMALL LETTER ALPHA}", 0.0, 1.0, 0.01, wish.alpha)
        material = gui.add_dropdown("Material", MATERIALS, initial_value=wish.material)
    controls.on(alpha, lambda: session.change(alpha=float(alpha.value)))
    controls.on(material, lambda: session.change(material=material.value))
