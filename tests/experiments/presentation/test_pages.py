"""Text of a user is text in every form of a page."""

from impact_xval.experiments.presentation.page.html import html_of
from impact_xval.experiments.presentation.pages import escape_latex, escape_markdown, latex_of

HOSTILE = "<script>alert(1)</script> 100% of $x_1^2$ & {a} \\input{b} | #1 ~ `c` *d* [e](f) ![g](h) \"i\" 'j'"


def test_text_of_a_user_is_shown_as_text():
    text = escape_markdown(HOSTILE)
    markdown = f"# {text}\n\nOf {text}.\n\n| {text} |\n| --- |\n| {text} |\n"
    page = html_of(markdown, HOSTILE)
    assert not any(tag in page for tag in ("<script", "<img", "href"))
    assert page.count("&lt;script&gt;alert(1)&lt;/script&gt;") == 5
    text = latex_of(markdown)
    assert text.count(r"\textless{}script\textgreater{}") == 5
    assert r"\input{b}" not in text


def test_escapes():
    assert escape_markdown("a\n\n# b\r\n| c") == "a \\# b \\| c"
    assert escape_markdown("a|b<c>&*_`") == "a\\|b&lt;c&gt;&amp;\\*\\_\\`"
    assert escape_latex("50% & \\x{é漢}") == r"50\% \& \textbackslash{}x\{é{[}U+6F22{]}\}"
