"""What a document asks its reader to do: its fenced blocks, in order, each with its rules (standard library only).

A rule is an HTML comment on the line before a block, which no reader sees: `<!-- follow: RULE; RULE -->`.

    after quickstart     the page begins with the data of a quickstart (on any block of the page)
    bench                from here on RIG.toml is the rig file of a virtual rig that listens, with its operator
    bench FILE           the same of the rig in this file, without an operator
    mount N              before the block a person mounts N tips, and plugs in their cells, on the virtual rig of `bench`
    slurm                from here on sbatch, squeue and scancel use a Slurm of one node, this machine
    wait N s             what a person does before the block takes N seconds
    background           the block runs until the page ends; it is ready when it prints a line
    instead              first ends what runs in the background
    for N s              the block runs until Ctrl-C, which is sent after N seconds
    exit N               the block ends with this status
    file NAME            the block is the content of a file
    output               the block is what the blocks before it have printed; numbers may differ
    with NAME=VALUE      NAME stands for VALUE
    needs WORD ..        programs, or modules of Python, without which the block is left out; `rig` (a physical
                         one), `person`, `network`: what no machine has while it follows
    long                 minutes or hours: left out of the short form

Language of a block: `sh` is run line by line, `python` as one program; any other is shown only. A block
without a language is an error.
"""

import dataclasses
import pathlib
import re

RULE = re.compile(r"<!-- follow: (.*?) -->")
FENCE = re.compile(r"^(\s*)```\s*(\S*)\s*$")
WITH_VALUE = {"after", "bench", "exit", "file", "for", "mount", "needs", "wait", "with"}
ALONE = {"bench", "background", "instead", "output", "long", "slurm"}
UNIT = r" (?:ms|s|min|h)\b(?: \d+ (?:s|min)\b)*"
VARIABLE = re.compile(rf"(\d+(?:,\d{{3}})*(?:\.\d+)?(?:{UNIT})?|\.\.)")
# What a placeholder ends in is taken from the last text of this form that the page has printed.
PRINTED = {"cal-..": r"cal-[0-9a-f]{16}", "mdl-..": r"mdl-[0-9a-f]{16}", "ds-..": r"ds-[0-9a-f]{16}",
           "job-..": r"job-[0-9a-f-]{36}", "JOB": r"(?<=Submitted batch job )\d+", "KEY": r"palpate_[0-9a-f]{64}"}


@dataclasses.dataclass
class Block:
    """One fenced block: its page, line, language, text and rules."""

    page: str
    line: int
    language: str
    text: str
    rules: dict[str, str]


class DocumentError(Exception):
    """A block or rule that cannot be followed as it is written."""


def rules_of(comment: str, place: str) -> dict[str, str]:
    """The rules of a comment.

    >>> rules_of("background; needs nginx curl", "keys.md:1")
    {'background': '', 'needs': 'nginx curl'}
    """
    rules = {}
    for rule in comment.split(";"):
        word, _, value = rule.strip().partition(" ")
        if not (word in ALONE and not value or word in WITH_VALUE and value):
            raise DocumentError(f"{place}: follow: {rule.strip()}: no such rule")
        rules[word] = value
    return rules


def blocks_of(page: str, text: str) -> list[Block]:
    """The fenced blocks of a page.

    >>> page = "A\\n<!-- follow: exit 2 -->\\n```sh\\nfalse\\n```\\n1. B\\n\\n   ```toml\\n   a = 1\\n   ```\\n"
    >>> [(b.line, b.language, b.text, b.rules) for b in blocks_of("keys.md", page)]
    [(3, 'sh', 'false\\n', {'exit': '2'}), (8, 'toml', 'a = 1\\n', {})]
    """
    found, inside, rules = [], None, {}
    for number, line in enumerate(text.splitlines(), 1):
        fence = FENCE.match(line)
        if inside is not None:
            if fence:
                found.append(inside[0])
                inside = None
            else:
                block, indent = inside
                block.text += line.removeprefix(indent) + "\n"
        elif fence:
            if not fence[2]:
                raise DocumentError(f"{page}:{number}: a block without a language")
            inside, rules = (Block(page, number, fence[2], "", rules), fence[1]), {}
        elif comment := RULE.search(line):
            rules = rules_of(comment[1], f"{page}:{number}")
        elif rules and line.strip():
            raise DocumentError(f"{page}:{number}: a rule without a block")
    if inside or rules:
        raise DocumentError(f"{page}: ends inside a block, or with a rule")
    return found


def filled(block: Block, printed: str) -> str:
    """The text of a block without its placeholders, from its rule and from what the page has printed.

    >>> filled(Block("keys.md", 1, "sh", "promote cal-.. URL", {"with": "URL=http://a"}),
    ...        "cal-00000000000000aa, cal-00000000000000bb")
    'promote cal-00000000000000bb http://a'
    """
    text = block.text
    for pair in filter(None, block.rules.get("with", "").split()):
        name, _, value = pair.partition("=")
        text = re.sub(rf"\b{re.escape(name)}\b", lambda _: value, text)
    for placeholder, form in PRINTED.items():
        if re.search(rf"\b{re.escape(placeholder)}(?!\w)", text):
            seen = re.findall(form, printed)
            if not seen:
                raise DocumentError(f"{block.page}:{block.line}: nothing has printed a {placeholder}")
            text = re.sub(rf"\b{re.escape(placeholder)}(?!\w)", seen[-1], text)
    return text


def pattern_of(line: str) -> str:
    """The regular expression of a line whose numbers and durations may differ, and in which `..` is any text."""
    def variable(text: str) -> str:
        return ".*" if text == ".." else r"[\d.,]*\d" + (UNIT if " " in text else "")

    parts = VARIABLE.split(line)
    return "".join(variable(part) if n % 2 else re.escape(part) for n, part in enumerate(parts))


def missing_line(shown: str, printed: str) -> str | None:
    """The first line of an example of output that was not printed after the lines before it.

    Numbers and durations may differ, `..` stands for any text.

    >>> missing_line("run 1, quick: success\\ntook 5.3 s", "run 12, quick: success\\n  took 1 min 2 s\\n")
    >>> missing_line("run 1: success\\nrun 2: fail", "run 1: success\\n")
    'run 2: fail'
    """
    lines, at = printed.splitlines(), 0
    for wanted in filter(str.strip, shown.splitlines()):
        pattern = pattern_of(" ".join(wanted.split()))
        while at < len(lines) and not re.search(pattern, " ".join(lines[at].split())):
            at += 1
        if at == len(lines):
            return wanted.strip()
        at += 1
    return None


def inline_commands(page: str, text: str) -> list[tuple[int, str]]:
    """The commands that a page names within its sentences, with their lines.

    >>> inline_commands("keys.md", "Use `palpate rig home` or\\n`palpate queue\\nadd FILE --at 22:00`.")
    [(1, 'palpate rig home'), (2, 'palpate queue add FILE --at 22:00')]
    """
    prose = re.sub(r"^\s*```.*?^\s*```\s*$", lambda m: "\n" * m[0].count("\n"), text, flags=re.S | re.M)
    found = re.finditer(r"`(palpate [^`]*)`", prose)
    return [(prose.count("\n", 0, m.start()) + 1, " ".join(m[1].split())) for m in found]


def pages(root: pathlib.Path) -> list[pathlib.Path]:
    """The pages that are followed: the README and every how-to."""
    return [root / "README.md", *sorted((root / "docs/how-to").glob("*.md"))]
