"""The table of mutants, and what its runner makes of one."""

from test_release import ROOT, program

run = program("tests/mutants/run.py")


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
