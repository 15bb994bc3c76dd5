"""Text of a user is text in every form of a page; tables keep their captions and columns."""

import re

import pytest
from jinja2 import DictLoader, UndefinedError
from markupsafe import Markup

from impact_xval.experiments.presentation import pages
from impact_xval.experiments.presentation.page.html import html_of
from impact_xval.experiments.presentation.pages import (
    Heading,
    Paragraph,
    Table,
    blocks_of,
    escape_latex,
    escape_markdown,
    latex_of,
    render,
)

HOSTILE = "<script>alert(1)</script> 100% of $x_1^2$ & {a} \\input{b} | #1 ~ `c` *d* [e](f) ![g](h) \"i\" 'j'"
NOTE = "mujoco and pybullet were asked for the same law: one vote, not two."

PAGE = """\
{% from "table.md.j2" import table %}
# About {{ name }}

A paragraph
over two lines, {{ third | number }}, per |v0|.

{% call table(["solver|x", "n"], [[name, "1"], ["-", "2"]], solvers=["mujoco", "pybullet"]) %}
Of
{{ name }}
{% endcall %}

{% call table(["a", "b"], [["c", name]], text=2, detail=true) %}
More.
{% endcall %}

- {{ name }}
- and
  more
"""


@pytest.fixture
def markdown(monkeypatch):
    environment = pages._environment().overlay()
    shipped, _, _ = environment.loader.get_source(environment, "table.md.j2")
    environment.loader = DictLoader({"test.md.j2": PAGE, "table.md.j2": shipped})
    monkeypatch.setattr(pages, "_environment", lambda: environment)
    text = render("test.md.j2", name=HOSTILE, third=1 / 3)
    monkeypatch.undo()
    return text


def test_markdown_taken_apart_is_what_went_in(markdown):
    assert list(blocks_of(markdown)) == [
        Heading(f"About {HOSTILE}", 1),
        Paragraph("A paragraph over two lines, 0.333, per |v0|."),
        Table(f"Of {HOSTILE}. {NOTE}", ["solver|x", "n"], [[HOSTILE, "1"], ["-", "2"]], [False, True], False),
        Table("More.", ["a", "b"], [["c", HOSTILE]], [False, False], True),
        Paragraph(HOSTILE),
        Paragraph("and more"),
    ]


def test_html_shows_text_of_a_user_as_text(markdown):
    page = html_of(markdown, HOSTILE)
    assert "<script" not in page
    assert "<img" not in page
    assert "href" not in page
    assert page.count("&lt;script&gt;alert(1)&lt;/script&gt;") == 6
    assert page.count("<caption>") == page.count("<details>") == 1
    assert '<td style="text-align:right">2</td>' in page


def test_latex_shows_text_of_a_user_as_text(markdown):
    text = latex_of(markdown, details=True)
    assert text.count(r"\textless{}script\textgreater{}") == 6
    assert r"\input{b}" not in text
    assert text.count(r"\begin{longtable}{") == 2
    assert latex_of(markdown).count(r"\begin{longtable}{") == 1
    assert r"\begin{longtable}{lr}" in text


def test_text_of_a_user_stays_on_its_line():
    assert escape_markdown("a\n\n# b\r\n| c") == "a \\# b \\| c"


def test_escapes():
    assert escape_markdown("a|b<c>&*_`") == "a\\|b&lt;c&gt;&amp;\\*\\_\\`"
    assert escape_latex("50% & \\x{é漢}") == r"50\% \& \textbackslash{}x\{é{[}U+6F22{]}\}"


def test_pictures_become_figures_of_the_page(tmp_path):
    (tmp_path / "a-b.png").write_bytes(b"png")
    page = html_of("![What *it* shows](a-b.png)\n\n![](piece)\n", "", tmp_path, {"piece": Markup("<hr>")})
    assert re.findall(r'<img src="([^"]*)" alt="([^"]*)"', page) == [("data:image/png;base64,cG5n", "a b")]
    assert "<figcaption><b>Figure 1.</b> What it shows</figcaption>" in page
    assert "<hr>" in page


def test_sections_have_names_and_contents_lead_to_them():
    page = html_of("# T\n\n## A & b\n\n## A, b\n\n### c\n\n![](contents)\n", "")
    assert re.findall(r'<h([23]) id="([^"]*)">', page) == [
        ("2", "a-b"),
        ("2", "a-b-"),
        ("3", "c"),
        ("2", "contents"),
    ]
    assert re.findall(r'<a href="#([^"]*)">([^<]*)</a>', page) == [("a-b", "A &amp; b"), ("a-b-", "A, b")]


def test_a_template_without_one_of_its_facts_fails():
    with pytest.raises(UndefinedError):
        render("page.html.j2", title="a")


def test_many_solvers_of_one_law_are_counted_in_figures():
    names = [f"engine-{i}" for i in range(12)]
    assert pages.phrase("table.md.j2", "one_vote", names).endswith("the same law: one vote, not 12.")


def test_a_paragraph_with_its_number_is_the_caption_of_a_figure_and_that_of_a_table_is_not(tmp_path):
    (tmp_path / "a.png").write_bytes(b"png")
    table = "\n\n**Of a table.**\n\n| a |\n| --- |\n| 1 |\n"
    page = html_of("![x](a.png)\n\n**Figure 1.** What *it* shows." + table, "", tmp_path)
    assert "<figcaption><strong>Figure 1.</strong> What <em>it</em> shows.</figcaption>" in page
    page = html_of("![What it shows.](a.png)" + table, "", tmp_path)
    assert "<figcaption><b>Figure 1.</b> What it shows.</figcaption>" in page
    assert page.count("<caption>Of a table.</caption>") == 1
