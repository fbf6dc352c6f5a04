"""The table of mutants, and what its runner makes of one."""

import subprocess

import pytest
from test_release import ROOT, program

run = program("tests/mutants/run.py")

ROW = """
[[mutant]]
id = '{name}'
file = 'half.py'
what = ''
text = '{text}'
becomes = '{becomes}'
tests = ['test_half.py']
survived = '{reason}'
"""


def test_every_mutant_still_fits_and_has_an_outcome():
    table = run.table_of(ROOT)
    assert len({mutant["id"] for mutant in table}) == len(table)
    for mutant in table:
        source = (ROOT / mutant["file"]).read_text("utf-8")
        assert source.count(mutant["text"]) == 1, mutant["id"]
        assert mutant["text"] != mutant["becomes"], mutant["id"]
        assert bool(mutant.get("killed")) != bool(mutant.get("survived")), mutant["id"]
        for test in mutant["tests"]:
            path, _, function = test.partition("::")
            assert (ROOT / path).exists(), mutant["id"]
            assert function.split("[")[0] in (ROOT / path).read_text("utf-8"), mutant["id"]


@pytest.mark.slow
def test_a_mutant_that_nothing_notices_needs_a_reason(tmp_path, capsys, monkeypatch):
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    (tmp_path / "half.py").write_text("def half(x):\n    return x / 2  # of x\n")
    (tmp_path / "test_half.py").write_text(
        "from half import half\n\n\ndef test_half():\n    assert half(4) == 2\n"
    )
    (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = -ra\npythonpath = .\n")
    table = tmp_path / "tests/mutants/mutants.toml"
    table.parent.mkdir(parents=True)
    rows = {
        "killed": ("x / 2", "x / 3", ""),
        "survives": ("# of x", "# of y", ""),
        "may-survive": ("# of x", "# of z", "a comment"),
        "gone": ("x / 4", "x / 5", ""),
        "syntax": ("x / 2", "x /", ""),
        "endless": ("return x", "while x: x", ""),
    }
    table.write_text(
        "# kept\n"
        + "".join(
            ROW.format(name=name, text=text, becomes=becomes, reason=reason)
            for name, (text, becomes, reason) in rows.items()
        )
    )
    assert run.main(tmp_path, ["killed", "surv", "may", "gone", "syntax", "--write"]) == 1
    told = capsys.readouterr().out
    assert "its text is in half.py 0 times" in told
    assert "1 killed, 2 survived, 2 faulty" in told
    assert "Not as they should be: survives, gone, syntax" in told
    assert table.read_text().startswith("# kept\n")
    found = {mutant["id"]: mutant for mutant in run.table_of(tmp_path)}
    assert found["killed"]["killed"] == "test_half.py::test_half"
    assert (tmp_path / "half.py").read_text().count("x / 2") == 1
    assert run.main(tmp_path, ["may", "killed"]) == 0
    assert run.main(tmp_path, ["elsewhere"]) == 2
    monkeypatch.setattr(run, "LIMIT_S", 1)
    assert run.main(tmp_path, ["endless"]) == 0
    (tmp_path / "test_half.py").write_text("def test_half():\n    assert False\n")
    assert run.main(tmp_path, ["killed"]) == 2
