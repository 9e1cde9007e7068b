"""Run the notebooks of examples/ and store what they print and draw: python tools/notebooks.py [NOTEBOOK...]

Each code cell runs in one namespace; as in Jupyter, figures left open and the value of a last line are its outputs.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import sys
import time
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
DPI = 80


def run(notebook: dict[str, Any], name: str) -> dict[str, Any]:
    """Run a notebook's code cells and put their outputs into them. Returns the namespace."""
    names: dict[str, Any] = {"__name__": "__main__"}
    plt.close("all")  # what was drawn before is no output
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for count, cell in enumerate(cells, 1):
        cell["execution_count"] = count
        cell["outputs"] = run_cell("".join(cell["source"]), names, f"{name}, cell {count}")
        for output in cell["outputs"]:
            if output["output_type"] == "execute_result":
                output["execution_count"] = count
    return names


def run_cell(source: str, names: dict[str, Any], where: str) -> list[dict[str, Any]]:
    """What a cell prints, shows and draws, in Jupyter's form."""
    tree, value, printed = ast.parse(source), None, io.StringIO()
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, where, "exec"), names)
        if last is not None and not source.rstrip().endswith(";"):
            value = eval(compile(ast.Expression(last.value), where, "eval"), names)
        elif last is not None:
            eval(compile(ast.Expression(last.value), where, "eval"), names)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(True)})
    if value is not None:
        data = {"text/plain": repr(value).splitlines(True)}
        if hasattr(value, "_repr_html_"):
            data["text/html"] = value._repr_html_().splitlines(True)
        outputs.append({"output_type": "execute_result", "data": data, "metadata": {}})
    for number in plt.get_fignums():
        picture = io.BytesIO()
        plt.figure(number).savefig(picture, format="png", dpi=DPI, metadata={"Software": ""})
        data = {"image/png": base64.b64encode(picture.getvalue()).decode()}
        outputs.append({"output_type": "display_data", "data": data, "metadata": {}})
    plt.close("all")
    return outputs


def main(paths: list[str]) -> None:
    for path in [Path(p) for p in paths] or sorted(EXAMPLES.glob("*.ipynb")):
        notebook, started = json.loads(path.read_text(encoding="utf-8")), time.process_time()
        run(notebook, path.name)
        path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"{path}: {time.process_time() - started:.1f} s of CPU time")


if __name__ == "__main__":
    main(sys.argv[1:])
