"""Turn executed notebooks into pages of the documentation.

    python benchmarks/notebook_pictures.py FOLDER
    python benchmarks/notebook_pages.py FOLDER docs/notebooks

Each page holds the text, the code and the outputs of a notebook; pictures lie beside it as WebP.
"""

import argparse
import base64
import io
import re
import sys
from pathlib import Path

import nbformat
from PIL import Image

WIDTH = 900  # pixels
QUALITY = 50
NOISE = ("Jupyter environment detected", "[Open3D INFO]")
"""Beginnings of lines that Open3D prints when it is imported."""


def page(notebook: nbformat.NotebookNode, name: str, folder: Path) -> str:
    """Return the text of a page, and write its pictures into a folder."""
    parts, number = [], 0
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for output in cell.outputs:
            if output.get("name") == "stderr":
                continue
            data = output.get("data", {})
            if "image/png" in data:
                file = folder / f"{name}_{number}.webp"
                write_picture(base64.b64decode(data["image/png"]), file)
                parts.append(f"![Output of the cell above, picture {number}]({file.name})")
                number += 1
            elif "text/html" in data:
                parts.append(table(data["text/html"]))
            elif text := plain(data.get("text/plain", "") if data else output.get("text", "")):
                parts.append(f"```text\n{text}\n```")
    note = f"*This page is the notebook `notebooks/{name}.ipynb` with its outputs.*"
    return "\n\n".join([parts[0], note, *parts[1:]]) + "\n"


def write_picture(content: bytes, file: Path) -> None:
    """Write a picture, no wider than the page."""
    picture = Image.open(io.BytesIO(content)).convert("RGB")
    if picture.width > WIDTH:
        picture = picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)
    picture.save(file, quality=QUALITY, method=6)


def table(html: str) -> str:
    """Return a table of pandas without its style sheet."""
    found = re.search(r"<table.*?</table>", html, re.DOTALL)
    return found.group().replace(' border="1" class="dataframe"', "") if found else ""


def plain(text: str) -> str:
    """Return terminal output without control sequences and without the folders of this machine."""
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    text = text.replace(str(Path.cwd()), "PROJECT")
    lines = [line.split("\r")[-1].rstrip() for line in text.split("\n") if not line.startswith(NOISE)]
    return "\n".join(lines).strip("\n")


def main() -> int:
    """Write the pages of all executed notebooks of a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("executed", type=Path)
    parser.add_argument("pages", type=Path)
    options = parser.parse_args()
    options.pages.mkdir(parents=True, exist_ok=True)
    for path in sorted(options.executed.glob("*.ipynb")):
        text = page(nbformat.read(path, as_version=4), path.stem, options.pages)
        (options.pages / f"{path.stem}.md").write_text(text, encoding="utf-8")
        print(path.stem, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
