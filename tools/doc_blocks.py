"""Run the code blocks of the docs as they stand: python tools/doc_blocks.py [PAGE...]   (make docs-test: all of them)

Each page has a folder of its own, with `scenes` in it; blocks run in their order, Python in one namespace, commands by
a shell.
Comments before a block, which no reader sees, say what else is needed:

<!-- docs-test: file PATH -->             the block is this file
<!-- docs-test: after TEXT in PATH -->    the block stands behind the line of PATH that holds TEXT
<!-- docs-test: files of PAGE -->         the files of another page are needed
<!-- docs-test: setup COMMAND -->         to be run before
<!-- docs-test: replace "OLD" "NEW" -->   in the block, to make it shorter
<!-- docs-test: shows TEXT -->            what its output holds
<!-- docs-test: output -->                the block is output of the block before; only its numbers may differ
<!-- docs-test: skip WHY -->              it is not run
<!-- docs-test: checkout -->              the page is about a checkout: its folder is a copy of this one
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import textwrap
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
FENCE = re.compile(r"((?:^ *<!-- docs-test: .*? -->\n)*)^( *)```([^\n`]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+|·10[⁻⁰¹²³⁴-⁹]+)?(?:\(\d+\))?")  # 35.8393(14), 6.6·10⁻⁵
LANGUAGES = ("python", "sh", "yaml", "json", "toml", "text")


@dataclass(frozen=True)
class Block:
    """A block of code: where it stands, its language, and what the comments before it say."""

    page: Path
    line: int
    language: str
    text: str
    orders: tuple[tuple[str, str], ...]

    @property
    def where(self) -> str:
        return f"{self.page.relative_to(DOCS)}:{self.line}"

    def asked(self, order: str) -> list[str]:
        """The texts of the orders with this name."""
        return [rest for name, rest in self.orders if name == order]


def pages() -> list[Path]:
    """The pages that people wrote."""
    return sorted(p for p in DOCS.rglob("*.md") if "generated" not in p.relative_to(DOCS).parts)


def blocks(page: Path) -> list[Block]:
    """The blocks of a page."""
    text, found = page.read_text(encoding="utf-8"), []
    for match in FENCE.finditer(text):
        comments, _, language, body = match.groups()
        if language.startswith("{"):
            continue  # a directive of the site
        said = re.findall(r"<!-- docs-test: (\w+) ?(.*?) -->", comments)
        line = text.count("\n", 0, match.start(3)) + 1
        found.append(Block(page, line, language or "sh", textwrap.dedent(body), tuple(said)))
    return found


def run_page(page: Path) -> tuple[int, list[str]]:
    """Run the blocks of a page in the present folder. Returns how many were run, and what was not and why."""
    names: dict[str, Any] = {"__name__": "__main__"}
    count, skipped, output = 0, [], ""
    for block in blocks(page):
        if block.asked("skip"):
            skipped.append(f"{block.where}: {block.asked('skip')[0]}")
        elif block.language == "sh" and all(
            line.startswith(("make ", ".venv/bin/")) for line in block.text.splitlines()
        ):
            skipped.append(f"{block.where}: a study of a checkout")
        elif block.asked("output"):
            missing = find_missing_lines(block.text, output)
            assert not missing, f"{block.where}: no line like {missing[0]!r} in\n{output}"
        elif block.language != "text":
            started = time.monotonic()
            output = run(block, names)
            count += 1
            print(f"{block.where}: {block.language}, {time.monotonic() - started:.1f} s", flush=True)
    return count, skipped


def find_missing_lines(shown: str, output: str) -> list[str]:
    """Find the lines of a block that no line of the output equals; only numbers may differ."""

    def replace_numbers(line: str) -> str:
        return " ".join(NUMBER.sub("#", line).split())

    printed = {replace_numbers(line) for line in output.splitlines()}
    return [line for line in shown.splitlines() if line.strip() and replace_numbers(line) not in printed]


def run(block: Block, names: dict[str, Any]) -> str:
    """Run one block and return what it prints. Raises whatever goes wrong."""
    for page in block.asked("files"):
        for other in blocks(DOCS / page.removeprefix("of ")):
            put(other)
    for command in block.asked("setup"):
        shell(command)
    text = block.text
    for words in block.asked("replace"):
        old, new = shlex.split(words)
        assert old in text, f"{block.where}: nothing to replace: {old}"
        text = text.replace(old, new)
    if put(block):
        return ""
    if block.language == "python":
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            exec(compile(text, block.where, "exec"), names)
        output = said.getvalue()
    elif block.language == "sh":
        output = shell(allow_for_load(text))
    else:
        output = str({"yaml": yaml.safe_load, "json": json.loads, "toml": tomllib.loads}[block.language](text))
    for wanted in block.asked("shows"):
        assert wanted in output, f"{block.where}: expected {wanted!r} in\n{output}"
    return output


def allow_for_load(text: str) -> str:
    """Give searches an hour instead of ten minutes, which a clock counts, also while other programs run."""
    return re.sub(r"\bdiscrepancy find (?!.*--minutes)", "discrepancy find --minutes 60 ", text)


def put(block: Block) -> bool:
    """Write a block that is a file, or a part of one, and say whether it is."""
    for path in block.asked("file"):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_text(block.text, encoding="utf-8")
    for order in block.asked("after"):
        text, _, path = order.rpartition(" in ")
        lines = Path(path).read_text(encoding="utf-8").splitlines(keepends=True)
        (at,) = (k for k, line in enumerate(lines) if text in line)
        indent = " " * (len(lines[at]) - len(lines[at].lstrip()))
        lines.insert(at + 1, textwrap.indent(textwrap.dedent(block.text), indent))
        Path(path).write_text("".join(lines), encoding="utf-8")
    return bool(block.asked("file") or block.asked("after"))


def shell(text: str) -> str:
    """Run commands and return what they print. Raises RuntimeError with their output if one fails."""
    done = subprocess.run(["bash", "-euc", text], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{text}\nended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def in_a_folder(page: Path) -> bool:
    """Run a page in a process and a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        root = ROOT
        if any(block.asked("checkout") for block in blocks(page)):
            root = Path(folder)
            for name in ("src", "tests", "benchmarks", "tools", "scenes", "examples", "docs"):
                shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__", "generated"))
            shutil.copy(ROOT / "pyproject.toml", root)
        else:
            (Path(folder) / "scenes").symlink_to(ROOT / "scenes")
        (Path(folder) / "out").mkdir()
        path = f"{root / 'src'}:{root}:{folder}/installed"
        places = {
            "PYTHONPATH": path,
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "MPLBACKEND": "Agg",
        }
        words = [sys.executable, Path(__file__), "--here", page]
        return subprocess.run(words, cwd=folder, env=os.environ | places, check=False).returncode == 0


def main(words: list[str]) -> int:
    if words[:1] == ["--here"]:
        sys.path.insert(0, "")  # as where a user starts Python in the page's folder
        count, skipped = run_page(Path(words[1]))
        print(f"{Path(words[1]).relative_to(DOCS)}: {count} blocks run, {len(skipped)} not", *skipped, sep="\n  ")
        return 0
    wanted = [Path(word).resolve() for word in words] or pages()
    failed = [page for page in wanted if blocks(page) and not in_a_folder(page)]
    for page in failed:
        print(f"failed: {page.relative_to(ROOT)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
