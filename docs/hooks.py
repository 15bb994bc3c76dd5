"""What MkDocs adds to the pages: formulas, the keys of an experiment, their JSON schema, and a narrower breakpoint."""

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

#: Stands in `configuration.md` where the table of keys goes.
_MARK = "<!-- keys -->"

#: A formula in a sentence, as GitHub writes it: code between dollars. The marks after it must not begin a line. The
#: pattern is tried before that of code (priority 190).
_INLINE, _BEFORE_CODE = r"\$`([^`]+)`\$([,.;:)]*)", 195

#: Spaces around operators, left and right: browsers know names of functions as nothing, or as any operator.
_SPACES = {
    "ln": ("0.167em", "0.167em"),
    "sin": ("0.167em", "0.167em"),
    "max": ("0.167em", "0"),
    "min": ("0.167em", "0"),
    "/": ("0", "0"),
    "|": ("0", "0"),
}

#: After one of these a minus is a sign, and has no space to its right.
_BEFORE_A_SIGN = ("=", "(", ",", "←", "≤")

#: Widths in em, of 16 px, from which the theme shows the navigation beside the page: its own, and those of this site.
#: The theme has no option for them.
_WIDTHS = {"76.25em": "68.75em", "76.234375em": "68.734375em"}


def on_config(config):
    """Let fenced blocks of the language `math`, and formulas in sentences, become MathML."""
    fences = config["mdx_configs"].setdefault("pymdownx.superfences", {})
    fences["custom_fences"] = [{"name": "math", "class": "formula", "format": _block}]
    config["markdown_extensions"].append(_Formulas())
    return config


def to_mathml(latex, display):
    """Return a formula as MathML, which browsers show without a script; `display` is "inline" or "block"."""
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
    """Return a fenced block as a formula on a line of its own."""
    return f'<div class="{css_class}">{to_mathml(source, "block")}</div>'


class _Inline(InlineProcessor):
    """A formula in a sentence."""

    def handleMatch(self, m, data):  # noqa: N802
        """Keep the MathML from being read as Markdown."""
        formula = f'<span class="inline-formula">{to_mathml(m[1], "inline")}{m[2]}</span>'
        return self.md.htmlStash.store(formula), m.start(0), m.end(0)


class _Formulas(Extension):
    """Formulas in sentences."""

    def extendMarkdown(self, md):  # noqa: N802
        """Look for formulas before code."""
        md.inlinePatterns.register(_Inline(_INLINE, md), "formula", _BEFORE_CODE)


def on_files(files, config):
    """Add the JSON schema of an experiment, which editors check a file by."""
    schema = json.dumps(Config.model_json_schema(), indent=1)
    files.append(File.generated(config, "experiment.schema.json", content=schema))
    return files


def on_page_markdown(markdown, page, config, files):
    """Put the table of keys into its page."""
    if _MARK not in markdown:
        return markdown
    heading = "| key | meaning | default | legal |\n| --- | --- | --- | --- |\n"
    return markdown.replace(_MARK, heading + "\n".join(map(_row, experiment_keys())))


def _row(key):
    """Return the row of a key."""
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
