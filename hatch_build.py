"""What the package's metadata say that depends on the address of the repository."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?://|#)([^)\s]+)\)")


def with_addresses(text: str, repository: str, version: str) -> str:
    """Markdown whose links to files of the checkout lead to those of a version on GitHub.

    Without a repository the words of links stay, and pictures go. Links that are addresses, or
    places in the page itself, stay as they are.
    """

    def absolute(link: re.Match[str]) -> str:
        image, words, path = link.groups()
        if not repository:
            return "" if image else words
        form = "raw" if image else "blob"
        return f"{image}[{words}]({repository}/{form}/v{version}/{path})"

    return LINK.sub(absolute, text)


def addresses(repository: str, version: str) -> dict[str, str]:
    """The addresses that a package index shows, of a repository on GitHub."""
    return {
        "Repository": repository,
        "Documentation": f"{repository}/blob/v{version}/docs/index.md",
        "Changelog": f"{repository}/blob/v{version}/CHANGELOG.md",
        "Issues": f"{repository}/issues",
    }


class CustomMetadataHook(MetadataHookInterface):
    """Fills in README and addresses."""

    def update(self, metadata: dict[str, Any]) -> None:
        text = (Path(self.root) / "README.md").read_text("utf-8")
        repository = self.config["repository"].rstrip("/")
        text = with_addresses(text, repository, metadata["version"])
        if repository:
            metadata["urls"] = addresses(repository, metadata["version"])
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
