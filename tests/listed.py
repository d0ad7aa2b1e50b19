"""Writes tests/README.md: each file of tests, and what its docstring says that it shows.

    python tests/listed.py

A test compares the page with the files: who adds or removes a file runs this too, so that
a file of tests that is lost is seen.
"""

import ast
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE / "README.md"
_HEAD = """# Tests

`python -m pytest` runs these files; a test compares this list with the folder. Run
`python tests/listed.py` when you add, rename or remove one.

| file | what it shows |
|---|---|
"""


def files() -> list[str]:
    """Returns the files of tests by their paths below this folder."""
    return sorted(str(path.relative_to(HERE)) for path in HERE.rglob("test_*.py"))


def shows(name: str) -> str:
    """Returns the first line of a file's docstring."""
    text = ast.get_docstring(ast.parse((HERE / name).read_text())) or ""
    return text.partition("\n")[0]


def main() -> None:
    rows = (f"| `{name}` | {shows(name)} |\n" for name in files())
    PAGE.write_text(_HEAD + "".join(rows))


if __name__ == "__main__":
    main()
