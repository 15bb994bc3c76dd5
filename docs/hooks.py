"""What MkDocs adds to the pages: formulas, the keys of an experiment, and their JSON schema."""

import json
from xml.etree import ElementTree

from latex2mathml.converter import convert
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from mkdocs.structure.files import File

from impact_xval.experiments.config.axes import LEGAL
from impact_xval.experiments.config.experiment import Config

#: Stands in `configuration.md` where the table of keys goes.
_MARK = "<!-- keys -->"

#: A formula in a sentence, as GitHub writes it: code between dollars. It begins before code does (priority 190).
_INLINE, _BEFORE_CODE = r"\$`([^`]+)`\$", 195

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
        return self.md.htmlStash.store(to_mathml(m[1], "inline")), m.start(0), m.end(0)


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
    return markdown.replace(
        _MARK, "| key | default | legal |\n| --- | --- | --- |\n" + "\n".join(_rows(Config))
    )


def _rows(model, before=""):
    """Give a row a key; tables that have a default are followed into."""
    for name, field in model.model_fields.items():
        default = field.get_default(call_default_factory=True)
        if hasattr(type(default), "model_fields"):
            yield from _rows(type(default), f"{before}{name}.")
        else:
            shown = "" if default is None else f"`{json.dumps(default)}`"
            legal = field.description or LEGAL["e1" if name == "e" else name].text
            yield f"| `{before}{name}` | {shown} | {legal.replace('|', chr(92) + '|')} |"
