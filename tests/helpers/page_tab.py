"""Tab with the page of an output: colours of its points, keys that decide, errors of its console."""

import io

import numpy as np
from helpers.page_output import ORIGIN
from PIL import Image

from mlsroad_pipeline.algorithms.core.palette import COLOURS, hex_to_rgb

ROAD, POLE = (hex_to_rgb(COLOURS[name]) for name in ("road", "utility_pole"))  # of the classes 11 and 64
READY = "window.page?.complete && page.model.tiles.state === 'ready' && !page.cloud.loading && page.cloud.shown > 30000"


def settle(tab):
    """Wait until a frame that nothing is missing from has been drawn."""
    tab.until("new Promise((done) => setTimeout(() => done(!page.cloud.loading), 250))")


def pixels(tab, colour, *, near=0.03):
    """Return the number of pixels of the cloud that have a colour, in any brightness: it follows the intensity."""
    picture = np.asarray(Image.open(io.BytesIO(tab.picture())).convert("RGB"), dtype=float)[50:770, 260:850]
    bright = picture.max(axis=2, keepdims=True)
    hue = picture / np.maximum(bright, 1) - np.array(colour) / max(colour)
    return int(((np.abs(hue).max(axis=2) <= near) & (bright[..., 0] > 80)).sum())


def saved(tab):
    tab.until("['ok', 'bad'].includes(page.model.saved.kind)")
    return tab.js("page.model.saved.text")


def decide(tab, key):
    tab.js("page.model.saved = {text: '', kind: ''}")
    tab.press(key)
    assert "at" in saved(tab) and tab.js("page.model.saved.kind") == "ok"
    tab.until("!page.model.busy")


def errors(tab):
    """Return errors of the console and requests to other places; notes on the software renderer are none."""
    found = [m for m in tab.messages if '"source": "rendering"' not in m]
    return found, [a for a in tab.addresses if not a.startswith(("http://127.0.0.1", "data:", "blob:"))]


def reload(tab, server):
    tab.open(f"http://127.0.0.1:{server.port}/", width=1200, height=800)
    tab.until(READY)
    tab.until("page.model.queued && page.model.counted")


def entries(tab):
    return tab.js("[...document.querySelectorAll('#queue li')].map((li) => li.innerText.replace(/\\s+/g, ' ').trim())")


def place_of(tab, x, y, z):
    """Return the place in the window of local coordinates."""
    return tab.js(
        f"(() => {{ const p = page.cloud.project([{x}, {y}, {z}]); const b = page.cloud.canvas.getBoundingClientRect();"
        " return [b.x + p.x, b.y + p.y]; })()"
    )


def click_at(tab, place):
    tab.drag(place, place, steps=1)


def local(x, y, z, tab):
    origin = tab.js("page.model.survey.origin")
    return [a + b - c for a, b, c in zip((x, y, z), ORIGIN.tolist(), origin, strict=True)]
