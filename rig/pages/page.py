"""Render pages from templates of other packages, with the common style, as self-contained files."""

import base64
import re
from importlib.resources import files
from itertools import count
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from rig.pages.numbers import with_minus
from rig.pages.palette import variables

FEWEST_HEADINGS = 4
"""Fewest headings of a page with a table of contents."""
_HEADING = re.compile(r"<h2>(.*?)</h2>", re.DOTALL)


def render(package: str, template: str, **values: Any) -> str:
    """Render a template of `package` that extends `base.html`."""
    style = Markup(f"{variables()}\n") + asset("style.css")  # noqa: S704 - colours of this package
    return with_contents(environment(package).get_template(template).render(style=style, **values))


def environment(package: str) -> Environment:
    """Return the environment of the templates of `package` and of this package."""

    def load(name: str) -> str | None:
        for place in (package, "rig.pages"):
            file = files(place).joinpath(name)
            if file.is_file():
                return file.read_text(encoding="utf-8")
        return None

    made = Environment(
        autoescape=True,
        loader=FunctionLoader(load),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=with_minus,
        extensions=["jinja2.ext.loopcontrols"],
    )
    made.filters["data"] = data_uri
    made.globals["asset"] = asset
    made.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    return made


def asset(name: str) -> Markup:
    """Return a style sheet or script of this package. It contains no user input, so it is not escaped."""
    return Markup(files("rig.pages").joinpath(name).read_text(encoding="utf-8"))  # noqa: S704


def with_contents(html: str) -> str:
    """Add ids to the headings of a long page, and a table of contents below its title."""
    headings = _HEADING.findall(html)
    if len(headings) < FEWEST_HEADINGS:
        return html
    numbers = count(1)
    html = _HEADING.sub(lambda match: f'<h2 id="part-{next(numbers)}">{match.group(1)}</h2>', html)
    links = "".join(
        f'<li><a href="#part-{number}">{text}</a></li>' for number, text in enumerate(headings, start=1)
    )
    contents = f'<nav aria-label="Contents"><ul class="contents">{links}</ul></nav>'
    place = html.index("<h2 id=")
    return f"{html[:place]}{contents}\n{html[place:]}"


def data_uri(image: bytes) -> str:
    """Return PNG, JPEG or WebP bytes as a data URI."""
    kinds = {b"\x89PNG": "png", b"RIFF": "webp"}
    kind = kinds.get(image[:4], "jpeg")
    return f"data:image/{kind};base64,{base64.b64encode(image).decode('ascii')}"
