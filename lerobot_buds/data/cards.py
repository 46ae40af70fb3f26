"""Cards of what is shared, as the Hub shows them: Markdown templates into which anybody's text may go."""

import re
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

_PLAIN = re.compile(r"[^\w .,:;()+%/=-]")


def render_card(template: str, **values: Any) -> str:
    """Fills in a template of ``templates``; what goes in is text, neither HTML nor Markdown.

    Args:
        template: Its name, for example ``dataset``.
        **values: What the template names; all of it.

    Returns:
        Markdown that ends in one line feed.
    """
    environment = Environment(
        loader=PackageLoader(__package__),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["text"], environment.filters["code"] = _text, _code
    return environment.get_template(f"{template}.md.jinja").render(values).strip() + "\n"


def _text(value: Any) -> Markup:
    """Makes anything one line of a table's cell: whatever might mean something to Markdown or HTML becomes a number."""
    line = " ".join(str(value).split())
    return Markup(_PLAIN.sub(lambda found: f"&#{ord(found.group())};", line))


def _code(value: Any) -> Markup:
    """Makes anything one line of a block of code, in which only the end of the block means something."""
    return Markup(" ".join(str(value).split()).replace("`", "'"))
