"""The runner of documented sessions: what it reads from a page, and what it finds different."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from documented_sessions import ROOT, SessionError, environment, missing_programs, run_page
from said_and_came import (
    first_difference,
    is_said,
    lines_that_came,
    same_drawing,
    told,
    updated,
)
from session_pages import (
    Code,
    Command,
    CopiedFile,
    Figure,
    PageError,
    WrittenFile,
    read_page,
    steps_of,
)

PAGE = """\
---
sessions: quick
requires: bash no-such-program
extras: explore h5
---
# A page

Take {download}`the table <files/table.csv>` and look at ![it](figure.svg).

```{code-block} yaml
:caption: parts/design.yaml
:linenos:

a: 1
```

```{code-block} yaml
shown: only
```

````{tip}
```console
$ echo one \\
    two
one two
$ false
[exit 1]

$ true
```
````

- in a list
  ```python
  print(1 + 1)
  ```
  ```text
  2
  ```

```python
x = 1
```
Words between.
```text
shown only
```

```{literalinclude} files/table.csv
:caption: copy.csv
```
"""


def test_a_page_is_read_in_order() -> None:
    assert steps_of(PAGE, "page.md") == [
        CopiedFile(8, "table.csv", "files/table.csv"),
        Figure(8, "figure.svg"),
        WrittenFile(10, "parts/design.yaml", "a: 1\n"),
        Command(23, "echo one \\\n    two", ("one two",), 25),
        Command(26, "false", (), 27, exit_code=1),
        Command(29, "true", (), 30),
        Code(35, "print(1 + 1)\n", ("2",), 38),
        Code(42, "x = 1\n", None, 42),
        CopiedFile(49, "copy.csv", "files/table.csv"),
    ]


def test_keys_at_the_head(tmp_path: Path) -> None:
    page = read_page(written(tmp_path, PAGE))
    assert page.is_quick
    assert page.extras == ["explore", "h5"]
    assert missing_programs(page, environment()) == ["no-such-program"]
    assert not read_page(written(tmp_path, "# No keys\n")).is_quick


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("```console\necho x\n```\n", "page.md:2: a session begins with a command, '$ ...'"),
        ("text\n```python\nx\n", "page.md:2: this block is never closed"),
    ],
)
def test_pages_that_are_no_sessions(text: str, said: str) -> None:
    with pytest.raises(PageError) as raised:
        steps_of(text, "page.md")
    assert str(raised.value) == said


@pytest.mark.parametrize(
    ("said", "came", "found"),
    [
        (["a", "b"], ["a", "b"], None),
        (["a", "..."], ["a"], None),
        (["...", "b"], ["x", "y", "b"], None),
        (["...", "a", "...", "a"], ["a", "a"], None),
        (["a ... c"], ["a b b c"], None),
        (["a... c"], ["a c"], None),
        (["...2 s"], ["12 s"], None),
        (["..."], [], None),
        (["a", "b"], ["a", "c"], (1, 1)),
        (["a"], ["a", "b"], (1, 1)),
        (["a", "b"], ["a"], (1, 1)),
        (["a", "...", "z"], ["a", "b", "c"], (2, 1)),
        (["...", "a"], ["a", "b"], (2, 1)),
        (["a.c"], ["abc"], (0, 0)),
        ([], ["a"], (0, 0)),
    ],
)
def test_where_page_and_output_part(
    said: list[str], came: list[str], found: tuple[int, int] | None
) -> None:
    assert first_difference(said, came) == found
    assert bool(told(said, came, 7)) == (found is not None)


def test_blanks_that_nobody_sees_count_for_nothing() -> None:
    assert lines_that_came("\n \n a  \r\n\n b\n\n") == [" a", "", " b"]
    assert is_said(" a ", " a")
    assert not is_said("a", " a")


def test_a_difference_names_the_line_of_the_page() -> None:
    assert told(["kp  1.0", "ki  2"], ["kp  1.0", "ki  3"], 40) == (
        "line 41 says\n  - ki  2\n  + ki  3\nall that came:\n  | kp  1.0\n  | ki  3"
    )


@pytest.mark.parametrize(
    ("said", "came", "written"),
    [
        (["?"], ["a", "b"], ["a", "b"]),
        (["a", "b"], ["x", "y", "z"], ["x", "y", "z"]),
        (["a", "..."], ["b", "c", "d"], ["b", "..."]),
        (["...", "total 3"], ["a", "b", "total 4"], ["...", "total 4"]),
        (["...", "gain 1", "..."], ["loss 7", "gain 2", "end"], ["...", "gain 2", "..."]),
        (["took ... s", "old"], ["took 12 s", "new"], ["took ... s", "new"]),
        (["a ...", "b"], ["a 1", "b"], ["a ...", "b"]),
    ],
)
def test_updates_keep_the_gaps(said: list[str], came: list[str], written: list[str]) -> None:
    assert updated(said, came) == written
    assert first_difference(written, came) is None


def test_figures_differ_by_more_than_rounding() -> None:
    drawing = '<path d="M 10.5 20 L 1e-05 3"/>'
    assert same_drawing(drawing, '<path d="M 10.5001 20 L 0 3"/>'.replace(" 0 ", " 0.9e-05 "))
    assert not same_drawing(drawing, '<path d="M 10.6 20 L 1e-05 3"/>')
    assert not same_drawing(drawing, '<path d="M 10.5 20 L 1e-05 3 Z"/>')


def written(folder: Path, text: str) -> Path:
    page = folder / "page.md"
    page.write_text(text, encoding="utf-8")
    return page


def go(tmp_path: Path, text: str) -> Path:
    """Run a page; the folder that it leaves."""
    folder = tmp_path / "session"
    folder.mkdir()
    run_page(read_page(written(tmp_path, text)), folder, environment())
    return folder


GOOD = """\
Take {download}`table.csv`.
```console
$ mkdir sub && cd sub
$ echo "$(basename "$PWD")"; echo wrong >&2; exit 3
sub
wrong
[exit 3]
$ cat ../table.csv
1;2
```
```{code-block} text
:caption: note.txt
here
```
```console
$ cat note.txt
here
```
```python
import subprocess
value = 20 + 1
```
```python
print(value)
_ = subprocess.run(["echo", "from a program"])
```
```text
21
from ...
```
"""


def test_a_session_goes_on_from_step_to_step(tmp_path: Path) -> None:
    """Places, files, names and exit codes; streams as seen; Python beside the shell."""
    (tmp_path / "table.csv").write_text("1;2\n", encoding="utf-8")
    folder = go(tmp_path, GOOD)
    assert (folder / "sub" / "note.txt").read_text(encoding="utf-8") == "here\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("```console\n$ echo b\na\n```\n", "page.md:2: $ echo b\nline 3 says\n  - a\n  + b\n"),
        ("```console\n$ false\n```\n", "page.md:2: $ false\nexit code 1, the page says 0"),
        ("```console\n$ true\n[exit 2]\n```\n", "$ true\nexit code 0, the page says 2"),
        ("```python\nprint(1)\n```\n```text\n2\n```\n", "line 5 says\n  - 2\n  + 1\n"),
        ("\n```python\n\nx\n```\n", 'File "page.md", line 4'),
        ("```python\nimport os; os._exit(3)\n```\n", "block of Python\nended the interpreter"),
        ("{download}`none.csv`\n", "page.md:1: file\nnone.csv is no file beside the page"),
        (
            "```{code-block} text\n:caption: ../out.txt\nx\n```\n",
            "page.md:1: file\n../out.txt lies outside the folder of the session",
        ),
        ("```console\n$ echo x >f.svg\n```\n![f](f.svg)\n", "f.svg is missing"),
    ],
)
def test_sessions_that_go_otherwise(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(SessionError) as raised:
        go(tmp_path, text)
    assert said in str(raised.value)


def program(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, ROOT / "tests" / "documented_sessions.py", *arguments],
        capture_output=True,
        encoding="utf-8",
        check=False,
    )


def test_the_program_updates_pages_and_their_figures(tmp_path: Path) -> None:
    session = "```console\n$ echo a; echo b; echo '<svg/>' >f.svg\nold\n...\n```\n![f](f.svg)\n"
    page = written(tmp_path, session + "```python\nprint(7)\n```\n```text\n?\n```\n")
    assert program(page).returncode == 1
    done = program("--update", page)
    assert (done.returncode, done.stderr) == (0, "")
    assert "2 outputs changed" in done.stdout
    text = page.read_text(encoding="utf-8")
    assert "f.svg\na\n...\n```" in text
    assert text.endswith("```text\n7\n```\n")
    assert (tmp_path / "f.svg").read_text(encoding="utf-8") == "<svg/>\n"
    assert program(page).returncode == 0


def test_the_program_names_what_costs_too_much_or_is_missing(tmp_path: Path) -> None:
    page = written(tmp_path, "```console\n$ python -c 'sum(range(10**6))'\n```\n")
    done = program("--limit", "0.001", page)
    assert done.returncode == 1
    assert "s of processor time, 0 permitted" in done.stdout
    needing = written(tmp_path, "---\nrequires: no-such-program\n---\n")
    assert "needs no-such-program" in program(needing).stdout
