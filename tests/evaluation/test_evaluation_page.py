"""``edmsim evaluate --page``: a table and a figure of any number of controllers on one set of machines."""

from pathlib import Path
from urllib.parse import unquote

import matplotlib
import pytest

from edmsim.evaluation.compare import draw_returns, leaderboard, markdown_table, write_page

BOARD = Path(__file__).parents[2] / "docs" / "leaderboard.jsonl"


@pytest.mark.slow
def test_a_style_of_the_user_does_not_get_into_the_figures_of_a_page(tmp_path):
    made = leaderboard(BOARD)["edmsim/GapFeed-v2", "fast"]
    write_page(tmp_path / "plain.md", [made])
    with matplotlib.rc_context({"axes.facecolor": "black", "text.usetex": True}):
        write_page(tmp_path / "styled.md", [made])
    plain, styled = ((tmp_path / f"{name}-GapFeed-v2.png").read_bytes() for name in ("plain", "styled"))
    assert plain == styled


def test_a_page_has_the_table_and_a_row_of_the_figure_for_every_controller(tmp_path):
    made = leaderboard(BOARD)["edmsim/GapFeed-v2", "fast"]
    file = tmp_path / "new" / "compared.md"
    write_page(file, [made])
    text = file.read_text(encoding="utf-8")
    assert "\n".join(markdown_table(made)) in text
    assert "](compared-GapFeed-v2.png)" in text
    assert (tmp_path / "new" / "compared-GapFeed-v2.png").read_bytes().startswith(b"\x89PNG")
    write_page(file.with_name("my laws.md"), [made])
    link = file.with_name("my laws.md").read_text(encoding="utf-8").partition("](")[2].partition(")")[0]
    assert link == "my%20laws-GapFeed-v2.png"  # Markdown ends the address of a picture at a space
    assert file.with_name(unquote(link)).is_file()
    (axes,) = draw_returns(made).axes
    shown = [label.get_text() for label in axes.get_yticklabels()]
    assert sorted(shown) == sorted(made.results)
    assert shown[-1] == "oracle"
    dots = [line for line in axes.lines if len(line.get_xdata()) == len(made.seeds)]
    assert sorted(dots[-1].get_xdata()) == sorted(cut.total_return for cut in made.results["oracle"])
