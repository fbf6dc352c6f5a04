"""The workflows of the public CI: nothing but that service runs them."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
WORKFLOWS = ROOT / ".github" / "workflows"

pytestmark = pytest.mark.skipif(not WORKFLOWS.exists(), reason="no checkout: .github is not here")


@pytest.mark.parametrize("name", ["release.yml", "tests.yml"])
def test_jobs_and_commands_exist_actions_have_a_version_and_few_rights(name):
    """One job alone may do more than read: it proves to the index who it is, without a password."""
    text = (WORKFLOWS / name).read_text("utf-8")
    whole = yaml.safe_load(text)
    found: dict[str, Any] = whole["jobs"]
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    for job in found.values():
        assert set(job.get("needs", "").split()) <= set(found)
        assert (WORKFLOWS / Path(job.get("uses", "tests.yml")).name).exists()
        for step in job.get("steps", []):
            words = shlex.split(step.get("run", ""))
            if words[:1] == ["make"]:
                assert {word for word in words[1:] if "=" not in word} <= set(targets)
            for word in words:
                if word.endswith(".py"):
                    assert (ROOT / word).exists(), word
    for action in re.findall(r"uses: (?!\./)(\S+)", text):
        assert re.search(r"@(v\d+|release/v\d+)$", action), action
    assert "secrets." not in text
    assert whole["permissions"] == {"contents": "read"}
    rights = {key: job["permissions"] for key, job in found.items() if "permissions" in job}
    assert rights == ({"publish": {"id-token": "write"}} if name == "release.yml" else {})
