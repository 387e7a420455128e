"""Interactive plots by bokeh, whose code is embedded in the page."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from hammerstein.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLACE = "plots"
"""Id of the element for the plots."""


def refuse_without_library() -> None:
    """Before the work, raise InputError if bokeh is not installed."""
    if importlib.util.find_spec("bokeh") is None:
        raise InputError(
            "--interactive",
            "needs bokeh, which is not installed: python -m pip install 'hammerstein-control[interactive]'",
        )


def interactive_of(figures: Mapping[str, Figure], steps: Mapping[str, Mapping[str, Figure]]) -> Markup:
    """Scripts of interactive plots; empty without figures. Equal figures give equal bytes.

    Parameters
    ----------
    figures : shown always
    steps : of each value on a slider, by its name

    Raises InputError where bokeh is not installed.
    """
    refuse_without_library()
    from bokeh.embed import json_item

    from hammerstein.reporting.plots import plots_of

    layout = plots_of(figures, steps)
    if layout is None:
        return Markup()
    item = _numbered(json_item(layout))
    # Keys in bokeh's order: what is referred to comes first. "<" by its number: nothing ends the element.
    data = json.dumps(item, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    start = (
        f'Bokeh.embed.embed_item(JSON.parse(document.getElementById("{PLACE}-data").textContent), "{PLACE}");'
    )
    scripts = "\n".join(
        [
            *(f"<script>{text}</script>" for text in _bundle()),
            f'<script type="application/json" id="{PLACE}-data">{data}</script>',
            f"<script>{start}</script>",
        ]
    )
    return Markup(scripts)


@cache
def _bundle() -> tuple[str, ...]:
    """Scripts of bokeh, from its own package; no text in them ends the element that holds them."""
    from bokeh.resources import Resources

    found = Resources(mode="inline", components=["bokeh", "bokeh-widgets"], log_level="warn").js_raw
    return tuple(text.replace("</script", "<\\/script") for text in found)


def _numbered(item: Any) -> Any:
    """The same with ids counted from one: bokeh counts on from page to page, and draws some by chance."""
    ids: dict[str, str] = {}

    def walked(value: Any, key: str = "") -> Any:
        if isinstance(value, dict):
            return {name: walked(inside, name) for name, inside in value.items()}
        if isinstance(value, (list, tuple)):
            return [walked(inside) for inside in value]
        if key in ("id", "root_id", "target_id") and isinstance(value, str):
            return ids.setdefault(value, f"b{len(ids) + 1}")
        return value

    return walked(item)
