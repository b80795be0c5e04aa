"""How a page is put together: templates in their packages, one style, everything inside the file."""

import base64
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from rig.pages.palette import variables


def render(package: str, template: str, **values: Any) -> str:
    """Return the page of a template that lies in `package` and extends `base.html`."""

    def load(name: str) -> str | None:
        for place in (package, "rig.pages"):
            file = files(place).joinpath(name)
            if file.is_file():
                return file.read_text(encoding="utf-8")
        return None

    environment = Environment(
        autoescape=True,
        loader=FunctionLoader(load),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data"] = data_uri
    style = variables() + "\n" + files("rig.pages").joinpath("style.css").read_text(encoding="utf-8")
    # The style is this package's own text and holds no input.
    return environment.get_template(template).render(style=Markup(style), **values)  # noqa: S704


def data_uri(image: bytes) -> str:
    """Return PNG or JPEG bytes as an address that holds the picture itself."""
    kind = "png" if image.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(image).decode('ascii')}"
