"""Hooks that MkDocs calls while it builds the pages (`hooks` in mkdocs.yml).

They turn formulas into MathML, insert the table of the keys of an experiment, add the JSON schema of these keys, and
show the navigation on narrower screens than the theme does.
"""

import json
from pathlib import Path
from xml.etree import ElementTree

from latex2mathml.converter import convert
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.config.keys import experiment_keys

#: Comment in `configuration.md` that is replaced by the table of keys.
_MARK = "<!-- keys -->"

#: Pattern of a formula in a sentence, in GitHub's syntax: code between dollars. It includes the punctuation marks after
#: the formula, so that no line begins with such a mark. Its priority is above the priority of code (190).
_INLINE, _BEFORE_CODE = r"\$`([^`]+)`\$([,.;:)]*)", 195

#: Spaces to the left and to the right of operators and of names of functions. Without them browsers would set names of
#: functions without any space, or with the space of an ordinary operator.
_SPACES = {
    "ln": ("0.167em", "0.167em"),
    "sin": ("0.167em", "0.167em"),
    "max": ("0.167em", "0"),
    "min": ("0.167em", "0"),
    "/": ("0", "0"),
    "|": ("0", "0"),
}

#: Signs after which a minus is the sign of a number and has no space to its right.
_BEFORE_A_SIGN = ("=", "(", ",", "←", "≤")

#: Screen widths, in em of 16 px, from which the navigation stands beside the page: the width in the theme, and the
#: width that this site puts in its place. The theme has no option for this width.
_WIDTHS = {"76.25em": "68.75em", "76.234375em": "68.734375em"}


def on_config(config):
    """Return the configuration with rules that turn `math` blocks, and formulas in sentences, into MathML."""
    fences = config["mdx_configs"].setdefault("pymdownx.superfences", {})
    fences["custom_fences"] = [{"name": "math", "class": "formula", "format": _block}]
    config["markdown_extensions"].append(_Formulas())
    return config


def to_mathml(latex, display):
    """Return a LaTeX formula as MathML, which browsers show without a script; `display` is "inline" or "block"."""
    math = ElementTree.fromstring(convert(latex, xmlns="", display=display))
    for group in math.iter():
        before = ""
        for part in group:
            text = part.text or ""
            if text in _SPACES and "form" not in part.attrib:
                part.tag = "mo"
                part.attrib["lspace"], part.attrib["rspace"] = _SPACES[text]
            if text == "−" and before in _BEFORE_A_SIGN:
                part.attrib["form"] = "prefix"
            if part.tag != "mspace":
                before = text
    return ElementTree.tostring(math, encoding="unicode")


def _block(source, language, css_class, options, md, **others):
    """Return the HTML of a fenced `math` block: a formula on a separate line."""
    return f'<div class="{css_class}">{to_mathml(source, "block")}</div>'


class _Inline(InlineProcessor):
    """Markdown processor of a formula in a sentence."""

    def handleMatch(self, m, data):  # noqa: N802
        """Return the formula as stashed MathML, which Markdown does not process again, and its place in the text."""
        formula = f'<span class="inline-formula">{to_mathml(m[1], "inline")}{m[2]}</span>'
        return self.md.htmlStash.store(formula), m.start(0), m.end(0)


class _Formulas(Extension):
    """Markdown extension for formulas in sentences."""

    def extendMarkdown(self, md):  # noqa: N802
        """Register the processor of formulas, which runs before the processor of code."""
        md.inlinePatterns.register(_Inline(_INLINE, md), "formula", _BEFORE_CODE)


def on_files(files, config):
    """Return the files with the JSON schema of an experiment added, by which editors check a file."""
    schema = json.dumps(Config.model_json_schema(), indent=1)
    files.append(File.generated(config, "experiment.schema.json", content=schema))
    return files


def on_page_markdown(markdown, page, config, files):
    """Return a page with the table of keys in place of its mark."""
    if _MARK not in markdown:
        return markdown
    heading = "| key | meaning | default | legal |\n| --- | --- | --- | --- |\n"
    return markdown.replace(_MARK, heading + "\n".join(map(_row, experiment_keys())))


def _row(key):
    """Return the row of a key in the Markdown table of keys."""
    default = "" if key.default is None else f"`{json.dumps(key.default)}`"
    legal = key.legal.replace("|", r"\|")
    return f"| `{key.name}` | {key.meaning} | {default} | {legal} |"


def on_post_build(config):
    """Show the navigation beside the page on screens that are 1100 px wide, not only from 1220 px on."""
    changed = set()
    for pattern in ("stylesheets/*.css", "javascripts/bundle*.js"):
        for file in Path(config["site_dir"], "assets").glob(pattern):
            text = file.read_text(encoding="utf-8")
            for theirs, ours in _WIDTHS.items():
                if theirs in text:
                    text = text.replace(theirs, ours)
                    changed.add((pattern, theirs))
            file.write_text(text, encoding="utf-8")
    if {theirs for _, theirs in changed} != {*_WIDTHS} or len({pattern for pattern, _ in changed}) != 2:
        raise PluginError("the theme has other breakpoints than this hook expects: navigation may be hidden")
