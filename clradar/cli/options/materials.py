"""Options that say what meshes are made of, for the estimator that knows materials."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from clradar.cli.options.groups import option
from clradar.cli.options.simulation import Estimator
from clradar.cli.options.values import wrong_usage
from clradar.errors import ModelError, warn

if TYPE_CHECKING:
    from clradar import Material, Scene

PHYSICAL: Final = "physical"


@dataclass(frozen=True, kw_only=True)
class MaterialOptions:
    """What the meshes are made of."""

    material: str | None = option(
        None,
        "What the meshes are made of, which chooses the physical estimator: a name that "
        "`clradar materials` lists, or one of a file. [default: a perfect conductor]",
        metavar="NAME|FILE.toml:NAME",
    )
    material_of: list[str] | None = option(
        None,
        "The same of a part; may be repeated: --material palm --material-of thumb=skin.",
        metavar="PART=NAME",
    )
    materials: list[Path] | None = option(
        None, "Files whose materials have names, too; may be repeated.", metavar="FILE.toml"
    )

    @property
    def given(self) -> bool:
        """Whether a mesh gets a material."""
        return self.material is not None or bool(self.material_of)

    @property
    def files(self) -> list[Path]:
        """The files that are read, each once."""
        texts = [self.material, *(text.rpartition("=")[2] for text in self.material_of or [])]
        named = [_split(text)[0] for text in texts if text is not None]
        return list(dict.fromkeys([*(self.materials or []), *(f for f in named if f is not None)]))

    def estimator(self, chosen: Estimator | None) -> Estimator | None:
        """The estimator: `chosen`, or with a material the one that knows materials.

        Warns of a material that another one does not use.
        """
        if not self.given or chosen == PHYSICAL:
            return chosen
        if chosen is None:
            return PHYSICAL
        warn(f"--material: not used by --estimator {chosen}; {PHYSICAL} knows materials")
        return chosen

    def on(self, scene: Scene) -> Scene:
        """The scene of these materials.

        Raises
        ------
        typer.BadParameter
            An unknown material or part, or a part that is given twice; it lists those that are
            known.
        """
        known = self._known()
        if self.material is not None:
            scene = scene.with_material(_found("--material", self.material, known))
        by_part: dict[str, Material] = {}
        for text in self.material_of or []:
            part, equals, name = text.rpartition("=")
            if not equals or not part:
                raise wrong_usage("--material-of", f"expected PART=NAME, got '{text}'")
            if part in by_part:
                raise wrong_usage("--material-of", f"part '{part}' is given twice")
            by_part[part] = _found("--material-of", name, known)
        unknown = sorted(set(by_part) - set(scene.part_names))
        if unknown:
            raise ModelError(
                f"--material-of: expected parts of the meshes ({', '.join(scene.part_names)}), got "
                f"{', '.join(unknown)}"
            )
        return scene.with_material(by_part) if by_part else scene

    def _known(self) -> dict[str, Material]:
        from clradar import read_materials
        from clradar.model.known_materials import KNOWN

        known = dict(KNOWN)
        for path in self.materials or []:
            own = read_materials(path)
            hidden = sorted(set(own) & set(known))
            if hidden:
                warn(f"--materials: {path} has its own {', '.join(hidden)}, which hide known ones")
            known.update(own)
        return known


def _split(text: str) -> tuple[Path | None, str]:
    """File and name of ``FILE.toml:NAME``; no file in front of a plain name."""
    from clradar.model.material_file import SUFFIXES

    file, colon, name = text.rpartition(":")
    if colon and file.lower().endswith(SUFFIXES):
        return Path(file), name
    return None, text


def _found(option: str, text: str, known: dict[str, Material]) -> Material:
    from clradar import read_materials

    file, name = _split(text)
    if file is not None:
        known = read_materials(file)
    if name not in known:
        where = " or FILE.toml:NAME" if file is None else f" of {file}"
        raise wrong_usage(option, f"expected one of {', '.join(known)}{where}, got '{name}'")
    return known[name]
