"""What several tests of images need."""

import pytest

from clradar.imaging import fast


@pytest.fixture
def always_a_tree(monkeypatch: pytest.MonkeyPatch) -> None:
    """For "fast", however few the voxels or points are."""
    monkeypatch.setattr(fast, "FEW_TERMS", 0)
