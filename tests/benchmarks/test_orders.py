"""The benchmark of the orders prints a row for each mesh, and order 2 is nearer to rest than order 1."""

from benchmarks.orders import main


def test_rows_have_the_errors_of_both_orders(capsys) -> None:
    assert main(["--most-cells", "480", "--only", "heavy"]) == 0
    head, rule, *rows = capsys.readouterr().out.splitlines()
    assert head.startswith("| body | cells") and rule.count("---") == head.count("|") - 1
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [row[:5] for row in cells] == [
        ["heavy beam", "480", "1", "", "full"],
        *[["heavy beam", count, "2", "element", "full"] for count in ("30", "60", "480")],
        *[["heavy beam", count, "2", "points", "full"] for count in ("30", "60", "480")],
    ]
    errors = [float(row[5].removesuffix(" %")) for row in cells[:-1]]
    assert errors[0] > 30 and max(errors[1:]) < 1.5 and cells[-1][5] == "reference"
    assert all(float(row[6]) > 0 for row in cells)
