"""The benchmark of fronts prints a row for each scene and draws them."""

import pytest

from benchmarks import fronts
from pipeline.studies import sweep
from pipeline.studies.tradeoff.orders import OrderCost


@pytest.mark.slow
def test_a_bending_scene_costs_less_with_order_two(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(sweep, "find_spec", lambda name: None)  # points run in this process
    monkeypatch.setattr(fronts, "SCENES", (fronts.Scene("heavy_beam", 4, (0.25,), (0.5, 1)),))
    assert fronts.main(["--out", str(tmp_path)]) == 0
    head, rule, row = capsys.readouterr().out.splitlines()
    assert head.startswith("| scene | simulated") and rule.count("---") == head.count("|") - 1
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[:2] == ["heavy_beam", "1 s"] and cells[2].endswith("%") and len(cells) == 9
    assert (tmp_path / "orders.png").stat().st_size > 10_000


def test_costs_that_are_extrapolated_are_in_parentheses() -> None:
    assert fronts.format_cost(OrderCost(1, 12.34, None)) == "(12.3 s)"
    assert fronts.format_cost(OrderCost(1, float("inf"), None)) == "not reached"
