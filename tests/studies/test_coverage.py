"""Rows of the method tables that a study leaves out are named, so that none is forgotten."""

from pipeline.studies import coverage
from pipeline.studies.coverage import list_left_out
from pipeline.studies.scaling.step_cost import METHODS as SCALING_METHODS
from pipeline.studies.stability.slices import METHODS as STABILITY_METHODS


def test_a_key_that_no_method_has_counts_as_the_default():
    assert list_left_out([{}]) == [
        "model auto", "law linear", "rotation gram_schmidt", "stepper bdf2", "stepper symplectic_euler",
    ]  # fmt: skip


def test_a_new_row_is_left_out_until_a_study_has_it(monkeypatch):
    laws = {**coverage._TABLES, "law": (*coverage._TABLES["law"], "neo_hookean")}
    monkeypatch.setattr(coverage, "_TABLES", laws)
    assert list_left_out(STABILITY_METHODS.values()) == ["law neo_hookean"]


def test_stability_tries_every_row_and_scaling_says_that_it_leaves_out_bdf2():
    assert list_left_out(STABILITY_METHODS.values()) == []
    keys = [
        {key.removeprefix("method."): value for key, value in method.items()} for method in SCALING_METHODS.values()
    ]
    assert list_left_out(keys) == ["stepper bdf2"]
