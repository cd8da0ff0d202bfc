"""Pictures and transcripts of terminal sessions: python3 tests/figures/terminal.py PALPATE OUT [--check] [SCENE ..]

Each scene runs commands of PALPATE in a terminal of 100 columns, in an empty folder, with the virtual rig, and presses
the keys that a person would press. OUT gets SCENE.svg, the start of what was printed as a picture, and SCENE.txt, all
of it, as in `docs/transcripts/`. With --check it prints the lines whose form is not that of the transcript there, and
exits with 1 if there are any. Needs pexpect, pyte and rich.
"""

import pathlib
import re
import sys
import tempfile
import time

import pexpect
import pyte
from rich.console import Console
from rich.style import Style
from rich.text import Text

COLUMNS, LINES, KEPT = 100, 200, 52
PROMPT = "$ "
TRANSCRIPTS = pathlib.Path(__file__).resolve().parents[2] / "docs/transcripts"
COLOURS = {"default": None, "brown": "yellow"}


class Terminal:
    """A screen that programs write to, one after another."""

    def __init__(self, palpate: str, folder: str):
        self.palpate, self.folder = palpate, folder
        self.screen = pyte.Screen(COLUMNS, LINES)
        self.stream = pyte.Stream(self.screen)

    def run(self, words: str, keys: list[tuple[str, str]] = (), timeout_s: float = 300.0):
        """Runs `palpate WORDS`; presses each key after its pattern has been printed."""
        self.stream.feed(f"{PROMPT}palpate {words}\r\n")
        child = pexpect.spawn(self.palpate, words.split(), cwd=self.folder, encoding="utf-8",
                              dimensions=(LINES, COLUMNS), timeout=timeout_s,
                              env={"TERM": "xterm-256color", "HOME": self.folder, "USER": "ann",
                                   "PATH": "/usr/bin:/bin"})
        child.logfile_read = self
        for pattern, key in keys:
            child.expect(pattern)
            time.sleep(1.0)
            child.send(key)
        child.expect(pexpect.EOF)
        child.close()

    def write(self, text: str):
        """What a program prints."""
        self.stream.feed(text)

    def flush(self):
        """Nothing is held back."""

    def lines(self) -> list[Text]:
        """The screen as styled lines, without the empty ones at its end."""
        found = []
        for row in range(LINES):
            line, cells = Text(), self.screen.buffer[row]
            for column in range(COLUMNS):
                cell = cells[column]
                colour = lambda name: COLOURS.get(name, f"#{name}" if re.fullmatch("[0-9a-f]{6}", name) else name)
                style = Style(color=colour(cell.fg.replace("bright", "bright_")), bold=cell.bold, reverse=cell.reverse,
                              bgcolor=colour(cell.bg.replace("bright", "bright_")), underline=cell.underscore)
                line.append(cell.data, style)
            line.rstrip()
            found.append(line)
        while found and not found[-1].plain:
            found.pop()
        return found


def first_minutes(terminal: Terminal):
    """A run, stopped by Ctrl-C, and resumed by the same command."""
    terminal.run("run quickstart --speed 60", [(r"[1-9]\d*/264", "\x03"), ("c  continue", "s\r")])
    terminal.run("run quickstart --speed 60")


def detached(terminal: Terminal):
    """A run that is left, attached to, and left again; then the service ends."""
    terminal.run("run quickstart --speed 30 --detach")
    terminal.run("status")
    terminal.run("attach", [(r"[1-9]\d*/264", "\x03"), ("c  continue", "d\r")])
    terminal.run("stop --why the-lab-closes")
    time.sleep(5.0)
    terminal.run("runs")
    terminal.run("resume --yes")
    terminal.run("attach")


def reboot(terminal: Terminal):
    """A night with Ctrl-C, then the machine loses power: its service is killed. The same command resumes."""
    terminal.run("run quickstart --speed 30", [(r"[1-9]\d*/264", "\x03"), ("c  continue", "d\r")])
    time.sleep(3.0)
    terminal.stream.feed("(the machine loses power, and starts again)\r\n")
    kill(terminal.folder, 9)
    terminal.run("runs")
    terminal.run("run quickstart --speed 30")


def morning(terminal: Terminal):
    """What ran, and one run drawn."""
    terminal.run("run quickstart --speed 100 --json")
    terminal.screen.reset()
    terminal.run("runs")
    terminal.run("show last")


def mistakes(terminal: Terminal):
    """Three typical ones."""
    pathlib.Path(terminal.folder, "night.toml").write_text(
        'name = "night"\nseed = 1\nsensor = "sensors/ert-28.toml"\n\n'
        "[real_hex]\ntips = [4]\nconfigurations = 300\nblcok = 6\ndepth_step_um = 250\n")
    terminal.run("plan night.toml")
    terminal.run("run quikstart")
    terminal.run("estop")


SCENES = [first_minutes, detached, reboot, morning, mistakes]


def kill(folder: str, signal: int):
    """Ends the service of a folder, and with it its virtual rig."""
    try:
        process = re.search(r'"process":(\d+)', pathlib.Path(folder, "palpate-data/server.json").read_text())
        pexpect.run(f"kill -{signal} {process[1]}")
        time.sleep(5.0)
    except FileNotFoundError:
        pass


def forms(lines: list[str]) -> dict[str, str]:
    """The lines of a transcript by their form: without numbers, names of runs, progress and drawings."""
    found = {}
    for line in lines:
        if not re.search("[█░│┤\u2801-\u28ff]", line):
            form = re.sub("[0-9a-f]{8}(-[0-9a-f]+){4}", "UID", line)
            form = re.sub(r"\d[\d.,:-]*", "0", form)
            form = re.sub(r"0 (ms|s|min|h)( 0 (s|min))?\b", "TIME", form)
            found[" ".join(form.split())] = line
    return found


def differences(name: str, lines: list[str]) -> list[str]:
    """Lines whose form only the transcript has, with `-`, and those whose form only this session has, with `+`."""
    kept = TRANSCRIPTS / f"{name}.txt"
    old, new = forms(kept.read_text().splitlines()), forms(lines)
    gone = [f"- {line}" for form, line in old.items() if form not in new]
    return gone + [f"+ {line}" for form, line in new.items() if form not in old]


def main():
    """Plays the scenes."""
    palpate, out = str(pathlib.Path(sys.argv[1]).resolve()), pathlib.Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    wanted, is_old = [name for name in sys.argv[3:] if name != "--check"], False
    for scene in SCENES:
        name = scene.__name__.replace("_", "-")
        if wanted and name not in wanted:
            continue
        with tempfile.TemporaryDirectory() as folder:
            terminal = Terminal(palpate, folder)
            scene(terminal)
            kill(folder, 15)
        lines = terminal.lines()
        (out / f"{name}.txt").write_text("\n".join(line.plain for line in lines) + "\n")
        console = Console(record=True, width=COLUMNS, file=open("/dev/null", "w"))
        for line in lines[:KEPT]:
            console.print(line, no_wrap=True, soft_wrap=True)
        picture = console.export_svg(title="palpate (virtual rig)")
        # No font from elsewhere: the reader's own.
        picture = re.sub(r"@font-face \{.*?\}", "", picture, flags=re.DOTALL).replace("Fira Code", "DejaVu Sans Mono")
        (out / f"{name}.svg").write_text(picture)
        print(f"{out / name}.svg: {len(lines)} lines")
        found = differences(name, [line.plain for line in lines]) if "--check" in sys.argv else []
        is_old = is_old or bool(found)
        print(*found, sep="\n", end="\n" if found else "")
    sys.exit(int(is_old))


if __name__ == "__main__":
    main()
