"""The list of mutants fits the code: `make mutants` runs them."""

from .listed import ROOT, load


def test_every_mutant_can_be_put_in_and_has_tests():
    for mutant in load():
        assert (ROOT / mutant.file).read_text(encoding="utf-8").count(mutant.old) == 1, mutant
        assert mutant.old != mutant.new
        assert mutant.tests
        assert all((ROOT / place).exists() for place in mutant.tests), mutant


def test_there_are_sixty_over_all_packages():
    mutants = load()
    assert len({(mutant.file, mutant.old, mutant.new) for mutant in mutants}) == 60
    packages = {file.parent.name for file in (ROOT / "edmsim").glob("*/__init__.py")}
    assert len(packages) > 20
    assert {mutant.file.removeprefix("edmsim/").split("/")[0] for mutant in mutants} >= packages
