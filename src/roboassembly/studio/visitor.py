"""One visitor: what is asked for in the browser is queued, and done by a thread of the visitor's own, in turn."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from viser import ClientHandle, SceneClickEvent, UploadedFile

from roboassembly.errors import InputError, RoboAssemblyError
from roboassembly.furniture.model import Furniture
from roboassembly.learning.policy import Policy, guide_of, settings_of
from roboassembly.learning.registry import load_policy
from roboassembly.solvers.forward import SearchProgress, Watch
from roboassembly.solvers.guide import Guide
from roboassembly.studio.chooser import Chooser
from roboassembly.studio.downloads import send_plan
from roboassembly.studio.house import House
from roboassembly.studio.panel import Actions, Panel
from roboassembly.studio.requests import Requests
from roboassembly.studio.screen import FRAMES_PER_SECOND, Screen
from roboassembly.studio.session import Session
from roboassembly.studio.wares import Wares, find_below, open_path, open_plan, open_upload
from roboassembly.studio.words import told, upright_note
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.plan_file import Script

_PLAN = ".json"
_PROGRESS_EVERY = 0.1
"""Seconds."""


def open_first(house: House) -> None:
    """Make what visitors see first; the next to open it gets the same at once.

    Raises:
        InputError: as `open_path`.
    """
    if not house.furniture.endswith(_PLAN):
        open_path(house.furniture, house.scale, with_grasps=house.setting == "full")


class Visitor:
    """A browser that shows the page; `close` when it is gone.

    Args:
        client: the browser.
        house: what all visitors share.
    """

    def __init__(self, client: ClientHandle, house: House) -> None:
        self.client, self._house = client, house
        self._wares = Wares(house.folders)
        self._requests = Requests()
        self._cancelled = threading.Event()
        self._screen: Screen | None = None
        self._chooser: Chooser | None = None
        self.session: Session | None = None
        """Once furniture is open."""
        self._policies: dict[str, Policy] = {}
        self._gone = False
        self.panel = Panel(
            client.gui,
            self._wares.sources(),
            house.policies,
            house.roots,
            Actions(
                open=lambda: self._ask(self._open),
                upload=self._take_upload,
                open_path=lambda path: self._ask(lambda: self._open_path(self._find(path))),
                choose=lambda: self._ask(self._choose, "choose"),
                join=lambda: self._ask(self._join),
                undo=lambda: self._ask(self._undo),
                suggest=lambda: self._ask(self._suggest),
                run=lambda how: self._ask(lambda: self._run(how)),
                cancel=self._cancelled.set,
                scrub=lambda: self._ask(self._scrub, "scrub"),
                play=lambda: self._ask(self._toggle),
                look=lambda: self._ask(self._look, "look"),
                save=lambda name: self._ask(lambda: self._save(name)),
            ),
        )
        self.panel.setting.value, self.panel.seed.value = house.setting, house.seed
        client.scene.on_click()(self._clicked)
        self._ask(lambda: self._open_path(house.furniture))
        self._thread = threading.Thread(target=self._serve, name=f"visitor-{client.client_id}", daemon=True)
        self._thread.start()

    @property
    def at_work(self) -> bool:
        """Whether its thread still runs."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Stop whatever runs, soon."""
        self._gone = True
        self._ask(lambda: None)

    def _ask(self, request: Callable[[], None], once: str = "") -> None:
        if not self._requests.add(request, once):
            self._say("✗ Too much waits already; give it a moment.")

    def _serve(self) -> None:
        try:
            self._work()
        finally:
            if not self._gone:
                self._say("✗ Something broke here, and the terminal tells what. Load the page again.")

    def _work(self) -> None:
        """Do what is asked for, one after another; while nothing is, play on."""
        while True:
            due = time.monotonic() + 1.0 / FRAMES_PER_SECOND
            try:
                playing = self._screen is not None and self._screen.playing
                request = self._requests.next(timeout=1.0 / FRAMES_PER_SECOND if playing else None)
            except queue.Empty:
                self._advance(max(0.0, time.monotonic() - due))
                continue
            if self._gone:
                return
            self._cancelled.clear()
            try:
                request()
            except RoboAssemblyError as error:
                self._say(f"✗ {error}")

    # Opening

    def _open(self) -> None:
        panel = self.panel
        number = int(panel.number.value)
        self._begin(
            lambda: self._wares.open(panel.source.value, panel.piece.value, number, with_grasps=self._with_grasps)
        )

    def _open_path(self, path: str) -> None:
        if path.endswith(_PLAN):
            script, furniture = open_plan(Path(path))
            self._begin(lambda: furniture, script)
            self._repeat(script)
        else:
            self._begin(lambda: open_path(path, self._house.scale, with_grasps=self._with_grasps))

    def _find(self, name: str) -> str:
        """Path of a folder that may be opened by name."""
        if not name.strip():
            raise InputError("no folder named; write one")
        return str(find_below(self._house.roots, name.strip()))

    @property
    def _with_grasps(self) -> bool:
        return self.panel.setting.value == "full"

    def _repeat(self, script: Script) -> None:
        self._busily(lambda watch: self._present.repeat(script, watch), "Done again")

    def _take_upload(self, file: UploadedFile) -> None:
        """Let a file wait to be read; it is kept no longer than that."""

        def take() -> None:
            try:
                self._upload(file)
            finally:
                self.panel.forget_upload()

        if not self._requests.add(take):
            self.panel.forget_upload()
            self._say("✗ Too much waits already; bring the file again in a moment.")

    def _upload(self, file: UploadedFile) -> None:
        if file.name.lower().endswith(_PLAN):
            script = plan_file.decode(file.content, Path(file.name).name)
            self._begin(lambda: self._present.held if script.setting == "full" else self._present.furniture, script)
            self._repeat(script)
            return
        self._say(f"Reading {Path(file.name).name}; repair may take a while …")
        self._begin(lambda: open_upload(file.name, file.content, self._house.scale))

    def _begin(self, make: Callable[[], Furniture], script: Script | None = None) -> None:
        """A new session, as a plan asks for if one is given; what was there stays if the furniture cannot be had."""
        panel = self.panel
        setting, seed = (
            (panel.setting.value, int(panel.seed.value)) if script is None else (script.setting, script.seed)
        )
        session = Session(make(), setting, seed)
        panel.setting.value, panel.seed.value = setting, seed
        with self.client.atomic():
            if self._screen is not None:
                self._screen.clear()
            self.session = session
            self._screen = Screen(self.client, session)
            self._screen.look = self.panel.look
            self._chooser = Chooser(panel, session)
            self._settle()
        self._say("Click a point of one part, then one of another, and join them; or let it run.")

    # Choosing

    def _choose(self) -> None:
        with self.client.atomic():
            self._choice.offer()
            self._shown.choose(self._choice.ends)

    def _clicked(self, event: SceneClickEvent) -> None:
        """Find at once what was clicked on: parts may have moved when the click's turn comes."""
        screen = self._screen
        end = None if screen is None else screen.under(np.array(event.ray_origin), np.array(event.ray_direction))
        if end is not None:
            self._ask(lambda: self._picked(*end))

    def _picked(self, part: int, point: int | None) -> None:
        """A part or one of its points was clicked on."""
        with self.client.atomic():
            if self._choice.pick(part, point):
                self._shown.choose(self._choice.ends)

    # Doing

    def _join(self) -> None:
        session, (one, two) = self._present, self._choice.ends
        if one is None or two is None:
            raise InputError("choose a point of what moves and one of what waits first")
        tried = session.attempt((one[0], two[0], one[1], two[1], *self._choice.ways))
        if tried.merged:
            self._shown.extend()
        self._settle()
        self._say(told(session.furniture, tried) + upright_note(session.upright))

    def _undo(self) -> None:
        if not self._present.undo():
            raise InputError("there is nothing to take back")
        self._shown.shorten()
        self._settle()
        self._say("Took the last step back.")

    def _suggest(self) -> None:
        action = self._present.suggestion(self._guide())
        if action is None:
            self._say("The policy sees nothing worth trying.")
            return
        with self.client.atomic():
            self._choice.set(action)
            self._shown.choose(self._choice.ends)
        self._say("This is what the policy would do; join them, if you agree.")

    def _guide(self) -> Guide:
        return guide_of(self._policy(self.panel.policy.value))

    def _policy(self, name: str) -> Policy:
        if name not in self._house.policies:
            raise InputError("no such policy is offered; name it with --policies when the studio is started")
        if name not in self._policies:
            self._policies[name] = load_policy(name)
        policy = self._policies[name]
        if self._present.setting not in settings_of(policy):
            raise InputError(f"policy '{name}' chooses no grasps; the search alone would do")
        return policy

    def _run(self, how: str) -> None:
        session = self._present
        if session.joined.complete:
            raise InputError("all is assembled; undo some steps or open something else first")
        guide = self._guide() if how != "search" else None
        if how == "alone" and guide is not None:
            self._busily(lambda watch: self._alone(guide, watch), "Assembled")
        else:
            self._busily(lambda watch: session.search(guide, watch), "Assembled")

    def _busily(self, work: Callable[[Watch], str], done: str) -> None:
        """Do what takes its time, and show what it came to.

        Args:
            work: tells why it ended early; empty if it did not.
            done: said if it did not.
        """
        session = self._present
        before = session.merges
        self.panel.busy(True)
        try:
            said = work(self._watch())
        finally:
            self.panel.busy(False)
        if session.merges > before:
            self._shown.extend()
        self._settle()
        count = f"{session.merges - before} merges, {session.planning_steps:,} states checked in all"
        self._say(f"✗ {said}" if said else f"✓ {done}: {count}.{upright_note(session.upright)}")

    def _watch(self) -> Watch:
        whole, told_at = len(self._present.furniture.parts) - 1, 0.0
        done = self._present.merges

        def watch(standing: SearchProgress) -> bool:
            nonlocal told_at
            if time.monotonic() - told_at > _PROGRESS_EVERY:
                told_at = time.monotonic()
                self.panel.progress.value = 100.0 * (done + standing.merges) / whole
                self._say(
                    f"… {done + standing.merges} of {whole} merges, {standing.attempts} tried, "
                    f"{standing.states:,} states checked"
                )
            return not (self._cancelled.is_set() or self._gone)

        return watch

    def _alone(self, guide: Guide, watch: Watch) -> str:
        """The policy's surest choice again and again; why it ended, empty if the furniture stands."""
        session, states = self._present, self._present.planning_steps
        for k in range(len(session.furniture.parts)):
            if session.joined.complete:
                return ""
            if not watch(SearchProgress(k, k, session.planning_steps - states)):
                return "Stopped."
            action = session.suggestion(guide)
            if action is None:
                return "The policy sees nothing worth trying."
            tried = session.attempt(action)
            if not tried.merged:
                return told(session.furniture, tried).removeprefix("✗ ")
        return ""

    # Showing

    @property
    def _present(self) -> Session:
        if self.session is None:
            raise InputError("no furniture is open")
        return self.session

    @property
    def _shown(self) -> Screen:
        if self._screen is None:
            raise InputError("no furniture is open")
        return self._screen

    @property
    def _choice(self) -> Chooser:
        if self._chooser is None:
            raise InputError("no furniture is open")
        return self._chooser

    def _settle(self) -> None:
        """Bring all that depends on the state up to date."""
        session, panel, screen = self._present, self.panel, self._shown
        with self.client.atomic():
            panel.time.max = max(1, screen.last)
            panel.time.visible = panel.play.visible = screen.last > 0
            panel.time.value = screen.at
            self._choice.offer()
            screen.choose(self._choice.ends)
            screen.refresh()
            whole = len(session.furniture.parts) - 1
            failed = f" · {session.failures} failed" if session.failures else ""
            panel.status.content = (
                f"**{session.furniture.name}** · {session.merges} of {whole} merges{failed} · "
                f"{session.planning_steps:,} states checked · reward {session.reward:g}"
            )

    def _look(self) -> None:
        with self.client.atomic():
            self._shown.look = self.panel.look
            self._shown.refresh()

    def _scrub(self) -> None:
        self._shown.playing = False
        with self.client.atomic():
            self._shown.show(int(self.panel.time.value))

    def _toggle(self) -> None:
        screen = self._shown
        if not screen.playing and screen.at == screen.last:
            screen.show(0)
        screen.playing = not screen.playing

    def _advance(self, late: float) -> None:
        """The next frame, or a later one if it is high time."""
        screen = self._shown
        with self.client.atomic():
            screen.show(screen.at + 1 + int(late * FRAMES_PER_SECOND))
            self.panel.time.value = screen.at
        screen.playing = screen.at < screen.last

    def _say(self, text: str) -> None:
        self.panel.message.content = text

    def _save(self, name: str) -> None:
        send_plan(self.client, self._present.plan(), name)
        self._say(f"Saved {name}.")
