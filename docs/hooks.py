"""What MkDocs adds to the pages: keys of an experiment, and their JSON schema, from the classes that check them."""

import json

from mkdocs.structure.files import File

from impact_xval.experiments.config.axes import LEGAL
from impact_xval.experiments.config.experiment import Config

#: Stands in `configuration.md` where the table of keys goes.
_MARK = "<!-- keys -->"


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
