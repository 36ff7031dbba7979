"""How replicas get to know each other: hello, who is fresh and who lost its memory, who does not
belong here."""

from __future__ import annotations

from gspn_framework_package.execution.agreement import interface as io
from gspn_framework_package.execution.agreement.growth import Growth


class Meeting(Growth):
    """Says hello and hears it."""

    def _hello(self) -> io.Message:
        limit = self.plan.timing.evict_after
        members = self._member_names()
        silent = self.peers.silent(members, self.name, limit, self._now) if limit > 0 else set()
        return {
            "kind": "hello",
            "log": self.log_id,
            "incarnation": self.incarnation,
            "active": self.active,
            "known": dict(self.peers.known),
            "first": self._first_hash,
            "silent": sorted(silent),
            "forced": sorted(self.forced),
            "cast_out": sorted(self.cast_out),
        }

    def _on_hello(self, message: io.Message) -> None:
        sender = message["from"]
        peer = self.peers.get(sender)
        peer.log = message["log"]
        peer.active = message["active"]
        peer.silent = frozenset(message["silent"])
        peer.welcomes = message["known"].get(self.name, "")
        if message["first"] and self._first_hash and message["first"] != self._first_hash:
            self._refuse_stranger(sender, "%s has another first team" % sender)
            return
        fresh = sender not in self.peers.known
        if fresh:
            self.peers.known[sender] = message["log"]
            self._persist({"kind": "peer", "robot": sender, "log": message["log"]})
        if not self.active:
            for robot in message["forced"]:
                self._note_forced(robot)
        peer.cast_out = frozenset(message["cast_out"])
        strange = peer.welcomes not in ("", self.log_id)
        if strange and not (self.active or self.forgetful or self.joining):
            self._forget()
        self._consider_active()
        # in a large team answers to everybody's greetings would drown it: there the next hello will do
        if (fresh or not (message["active"] or message["known"].get(self.name))) and (self.is_small or self._request):
            self.answer(message, self._hello())
        if message["length"] == self.ledger.length and message["hash"] != self.ledger.hash:
            self._conflict(sender, self.ledger.length)
        elif message["length"] < self.ledger.length:
            known = self.history.hash_before(message["length"])
            if known is not None and known != message["hash"]:
                self._conflict(sender, message["length"])

    def _consider_active(self) -> None:
        """Become active once every other member of the first team knows our log as the first one
        that we have."""
        if self.active or self.joining or self.forgetful or self.ledger.length < 1:
            return
        others = [m for m in self._member_names() if m != self.name and m not in self.forced]
        if any(self.peers.get(m).welcomes != self.log_id for m in others):
            return
        self._become_active()
        team = self._member_names()
        if team and team[0] == self.name and self.incarnation == 0 and not self.partial:
            self.consensus.lead_from_the_start(set(team) - self.forced)
        self._act({})

    def _note_forced(self, robot: str) -> None:
        if robot != self.name and robot in self._member_names() and robot not in self.forced:
            self.forced.add(robot)
            slot = self.ledger.length
            self._persist({"kind": "forced", "slot": slot, "robots": sorted(self.forced)})

    def _hear_own_name(self, message: io.Message) -> None:
        if message.get("team") != self._tag or message.get("kind") != "hello":
            return
        same = message["log"] == self.log_id
        if message["incarnation"] > self.incarnation and (same or message["active"]):
            self._halt("another process runs as %s, and started later" % self.name)

    def _hear_stranger(self, sender: str, message: io.Message) -> None:
        run, _, plan = str(message.get("team")).rpartition("|")
        if run == self.run and plan != self.plan.hash()[:12]:
            self._refuse_stranger(sender, "%s has another plan" % sender)

    def _refuse_stranger(self, sender: str, what: str) -> None:
        if sender in self._strangers:
            return
        self._strangers.add(sender)
        if not self.active and self.plan.robots and sender in [r.name for r in self.plan.robots]:
            self._halt("%s (run '%s'); give all robots the same plan" % (what, self.run))
        else:
            self._fault("%s (run '%s'); it is not let in" % (what, self.run))
