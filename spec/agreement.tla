------------------------------ MODULE agreement ------------------------------
(* The protocol by which the robots of a team agree on one log, for TLC.      *)
(* docs/agreement.md describes it; README.md says how to read this file       *)
(* beside it, what is left out, and which part of the code each name stands   *)
(* for. Operators and fields have the names of the code, of                   *)
(* gspn_framework_package/execution/agreement.                                *)
EXTENDS Integers, Sequences, FiniteSets

CONSTANTS
  Robots,      \* number of robots; they are 1, 2, ... in the order of the plan
  Wants,       \* the robots that have an entry for the log at the beginning
  Spares,      \* the robots under whose names a second process may start
  Begun,       \* whether all robots take part at the beginning
  Partial,     \* partial synchronisation, instead of full
  MaxLength,   \* no robot proposes for later slots than this
  MaxCounter,  \* no ballot has a higher counter than this
  MaxLogs,     \* no robot has more logs, one after the other, than this
  \* how often each of these may happen
  Restarts,    \* a process is killed and starts again with its log
  Losses,      \* a process is killed and starts again without its log
  Outages,     \* the power of a machine fails, and the end of its log is lost
  Evictions,   \* a member finds another one silent
  Assertions,  \* an operator asserts that a robot is off
  Moves,       \* local transitions
  Pauses,      \* orders that no local transition may pass
  GiveBacks    \* orders that take a task from a robot, which then goes elsewhere

Robot == 1..Robots
Process == (Robot \X {0}) \union (Spares \X {1})
NONE == 0
NoneTorn == [r \in Robot |-> <<>>]

VARIABLES
  state,       \* process -> what it knows: ReplicaState
  disk,        \* process -> what of it would survive a loss of power
  sent,        \* all messages that were ever sent
  proposals,   \* all entries that were ever announced
  chosen,      \* all decisions of any robot: what a learn message holds
  log_ids,     \* robot -> how many logs its processes have had
  took_part,   \* the logs <<robot, log>> that ever were active
  acted,       \* <<robot, incarnation, log, start>> of all robots that ever acted
  faults       \* how often each fault may still happen

vars == <<state, disk, sent, proposals, chosen, log_ids, took_part, acted, faults>>

name(p) == p[1]
Max(a, b) == IF a > b THEN a ELSE b
SetMin(S) == CHOOSE x \in S : \A y \in S : x <= y
Range(q) == {q[i] : i \in DOMAIN q}

(* ---- ballots and quorums (quorum.py) ------------------------------------ *)

Ballot0 == <<0, 1, NONE>>  \* the first robot leads; all fresh replicas have promised this
less(b, c) ==
  \/ b[1] < c[1]
  \/ b[1] = c[1] /\ b[2] < c[2]
  \/ b[1] = c[1] /\ b[2] = c[2] /\ b[3] < c[3]

is_quorum(voters, members) ==
  LET count == Cardinality(voters \intersect members) IN
  IF 2 * count = Cardinality(members)
  THEN count > 0 /\ SetMin(members) \in voters
  ELSE 2 * count > Cardinality(members)

(* ---- the result of a log (ledger.py) ------------------------------------- *)

(* A batch is a sequence of items, a log a sequence of batches. Slot 0, which *)
(* follows from the plan, is left out: "length" is one less than in the code. *)

Ledger0 == [
  log      |-> <<>>,
  members  |-> Robot,
  left     |-> {},                      \* the robots that left in order
  lives    |-> [r \in Robot |-> 0],     \* the incarnation that the log knows
  logs     |-> [r \in Robot |-> NONE],  \* the log with which it was let in
  cast_out |-> [r \in Robot |-> -1],    \* the slot of its last eviction by force
  seen     |-> [r \in Robot |-> <<-1, 0, NONE>>],
  paused   |-> FALSE,
  sent_away |-> [r \in Robot |-> -1]]   \* the slot that last took a task from it

length(l) == Len(l.log)

is_news(l, i) ==
  LET known == l.seen[i.by] IN
  \/ i.incarnation > known[1]
  \/ i.incarnation = known[1] /\ i.number > known[2] /\ i.log = known[3]

is_cast_out(l, r) == l.cast_out[r] >= 0 /\ r \notin l.members

\* Join: _join of token_game.py, with Ledger._note_membership; Evict and Leave: _depart
entered(l, i) ==
  LET m == [l EXCEPT !.seen[i.by] = <<i.incarnation, i.number, i.log>>] IN
  CASE i.entry = "Join" /\ i.life > l.lives[i.by] ->
         [m EXCEPT !.members = @ \union {i.by}, !.left = @ \ {i.by},
                   !.lives[i.by] = i.life, !.logs[i.by] = i.log]
    [] i.entry = "Evict" /\ i.robot \in l.members /\ i.life = l.lives[i.robot]
         /\ l.members # {i.robot} ->
         [m EXCEPT !.members = @ \ {i.robot},
                   !.cast_out[i.robot] = IF i.forced THEN length(l) ELSE @]
    [] i.entry = "Leave" /\ i.robot \in l.members /\ l.members # {i.robot} ->
         [m EXCEPT !.members = @ \ {i.robot}, !.left = @ \union {i.robot}]
    [] i.entry = "Pause" -> [m EXCEPT !.paused = TRUE]
    [] i.entry = "GiveBack" -> [m EXCEPT !.sent_away[i.robot] = length(l)]
    [] OTHER -> m

RECURSIVE after_items(_, _), news(_, _)
after_items(l, items) ==
  IF items = <<>> THEN l
  ELSE after_items(IF is_news(l, Head(items)) THEN entered(l, Head(items)) ELSE l, Tail(items))
news(l, items) ==
  IF items = <<>> THEN <<>>
  ELSE IF is_news(l, Head(items))
       THEN <<Head(items)>> \o news(entered(l, Head(items)), Tail(items))
       ELSE news(l, Tail(items))

append(l, items) ==
  [after_items(l, items) EXCEPT !.log = Append(l.log, news(l, items))]

\* What messages carry to tell logs apart. Where logs cannot differ, their length is enough.
hash(l) == IF Assertions + Outages > 0 THEN l.log ELSE <<length(l)>>

(* ---- who may decide, whose log counts (electorate.py) -------------------- *)

members(s) == s.ledger.members
known_log(s, r) == IF s.ledger.logs[r] # NONE THEN s.ledger.logs[r] ELSE s.known[r]
is_our_name(p, s) == s.ledger.logs[name(p)] \in {NONE, s.log_id}
may_vote(p, s) == s.active /\ name(p) \in members(s) /\ is_our_name(p, s)
known_incarnation(p, s) == Max(s.ledger.seen[name(p)][1], s.ledger.lives[name(p)])
is_settled(p, s) ==
  s.active /\ name(p) \in members(s) /\ s.ledger.lives[name(p)] = s.incarnation
has_to_join(s) == ~s.active /\ s.amnesic
acted_before(p, s) == s.ledger.seen[name(p)][3] \notin {NONE, s.log_id}
spoken_for(p, s) ==
  \/ known_incarnation(p, s) > s.incarnation
  \/ LET seen == s.ledger.seen[name(p)] IN
     seen[1] = s.incarnation /\ seen[3] = s.log_id /\ seen[2] > s.number

asserted_off(s) == {r \in members(s) : s.off[r] = s.ledger.lives[r]}

may_decide(s, voters, by_all) ==
  \/ ~by_all /\ is_quorum(voters, members(s))
  \/ LET off == asserted_off(s)
         left == members(s) \ off
     IN (off # {} \/ by_all) /\ left # {} /\ left \subseteq voters

not_cast_out(s, voters, items, by_all) ==
  IF ~by_all /\ is_quorum(voters, members(s)) THEN {}
  ELSE asserted_off(s) \
    {i.robot : i \in {j \in Range(news(s.ledger, items)) :
       j.entry = "Evict" /\ j.forced /\ j.life = s.ledger.lives[j.robot]}}

may_choose(s, voters, items, by_all) ==
  may_decide(s, voters, by_all) /\ not_cast_out(s, voters, items, by_all) = {}

witnesses_of_start(p, s) ==
  LET others == members(s) \ {name(p)} IN
  {r \in IF others = {} /\ length(s.ledger) > 0 THEN Robot \ {name(p)} ELSE others :
     s.off[r] = -1}

can_teach(s, r) ==
  ~(s.by_all # NoneTorn /\ r \notin members(s))

\* After a loss of power: robot -> the id of its log, and of those that it goes on from.
torn(p, s) ==
  [r \in Robot |->
     IF r \notin members(s) THEN <<>>
     ELSE IF r = name(p) THEN (IF s.torn = <<>> THEN <<>> ELSE <<s.log_id>> \o s.torn)
     ELSE IF s.peers_torn[r] # <<>> /\ s.ledger.logs[r] # s.peers_torn[r][1]
          THEN s.peers_torn[r] ELSE <<>>]

\* The others are taken to be whole: a message from a torn log, that is not known, does not count.
needs_all(p, s) ==
  LET t == torn(p, s)
      whole == {r \in members(s) \ asserted_off(s) : t[r] = <<>>}
  IN IF t = NoneTorn \/ name(p) \notin members(s) \/ is_quorum(whole, members(s))
     THEN NoneTorn ELSE t

(* ---- what a step of a process does ---------------------------------------- *)

NoAttempt == [phase |-> 0, ballot |-> Ballot0, frozen |-> FALSE, torn |-> NoneTorn]
Nothing == <<>>  \* nothing accepted; otherwise <<ballot, batch>>

Fresh(id) == [
  \* in the log file
  log_id      |-> id,
  incarnation |-> 0,
  begin_records |-> 0,                      \* here: how often a process has begun with this log
  active      |-> FALSE,
  amnesic     |-> FALSE,
  torn        |-> <<>>,
  ledger      |-> Ledger0,
  promised    |-> Ballot0,
  accepted    |-> Nothing,
  by_all      |-> NoneTorn,
  known       |-> [r \in Robot |-> NONE],   \* peers.known
  unsure      |-> {},                       \* peers.unsure
  peers_torn  |-> NoneTorn,                 \* peers.torn
  dead        |-> {},                       \* peers.dead
  off         |-> [r \in Robot |-> -1],
  number      |-> 0,
  moves       |-> <<>>,                     \* local transitions that are not in the log
  \* in memory
  attempt     |-> NoAttempt,
  followers   |-> {},
  welcomes    |-> [r \in Robot |-> -1],     \* length of a peer's log that knows ours; -1: none
  frozen_by   |-> FALSE,
  started     |-> -1]                       \* the incarnation that acted

up(p) == state[p].log_id # NONE

without_memory(s) ==
  [s EXCEPT !.attempt = NoAttempt, !.followers = {}, !.frozen_by = FALSE, !.started = -1,
            !.welcomes = [r \in Robot |-> -1]]

acts(p, s) == IF is_settled(p, s) THEN [s EXCEPT !.started = s.incarnation] ELSE s

\* Tell robot r, which does not take part yet, which log of it we know.
greet(p, s, r) ==
  [kind |-> "hello", from |-> name(p), log |-> s.log_id, torn |-> s.torn,
   length |-> length(s.ledger), to |-> r, seen |-> known_log(s, r)]

\* All hellos to robots that do not take part yet, as soon as they can be sent. One more message
\* takes no behaviour away: it may be taken at any time, or never. So nothing is lost by it.
greetings(all) ==
  UNION {{greet(p, all[p], name(q)) :
            p \in {x \in Process : all[x].log_id # NONE /\ name(x) # name(q)
                                    /\ known_log(all[x], name(q)) # NONE}} :
         q \in {x \in Process : all[x].log_id # NONE /\ ~all[x].active /\ ~all[x].amnesic}}

\* Only who asked for a promise reads it, in its first phase, and no ballot has a second one.
is_read(m, all) ==
  \/ m.kind # "promise"
  \/ \E p \in Process :
       /\ all[p].attempt.phase = 1 /\ all[p].attempt.ballot = m.ballot
       /\ all[p].promised = m.ballot /\ length(all[p].ledger) = m.slot

\* Process p goes on as s, and sends these messages. "synced": its log is on the disk before.
Step(p, s, messages, synced) ==
  LET t == acts(p, s)
      all == [state EXCEPT ![p] = t]
  IN
  /\ t.log_id <= MaxLogs
  /\ state' = all
  /\ sent' = {m \in sent \union messages : is_read(m, all)} \union greetings(all)
  /\ disk' = IF Outages > 0 /\ synced THEN [disk EXCEPT ![p] = without_memory(t)] ELSE disk
  /\ log_ids' = [log_ids EXCEPT ![name(p)] = Max(@, t.log_id)]
  /\ took_part' = IF t.active /\ (Losses > 0 \/ Spares # {})
                  THEN took_part \union {<<name(p), t.log_id>>} ELSE took_part
  /\ acted' = IF is_settled(p, t)
              THEN acted \union {<<name(p), t.incarnation, t.log_id, t.begin_records>>} ELSE acted

Fault(f) == faults[f] > 0 /\ faults' = [faults EXCEPT ![f] = @ - 1]

new_id(p) == log_ids[name(p)] + 1

new_life(p, s) ==
  [s EXCEPT !.incarnation = Max(s.incarnation, known_incarnation(p, s)) + 1, !.number = 0]

\* Discard what we know; "keep": only the votes. The id of the log changes.
forget(p, s, keep) ==
  [s EXCEPT !.log_id = new_id(p), !.active = FALSE, !.amnesic = TRUE, !.torn = <<>>,
            !.unsure = {r \in Robot : s.known[r] # NONE}, !.off = [r \in Robot |-> -1],
            !.accepted = Nothing, !.by_all = NoneTorn, !.attempt = NoAttempt, !.followers = {},
            !.frozen_by = FALSE, !.moves = <<>>,
            !.ledger = IF keep THEN s.ledger ELSE Ledger0]

\* Append a slot: _commit, next_slot, note_members, _after_slot, note_own_fate.
commit(p, s, items, mine) ==
  LET me == name(p)
      kept == Range(news(s.ledger, items))
      l == append(s.ledger, items)
      returned == {i.by : i \in {j \in kept : j.entry = "Join"}}
      still(i) == is_news(l, i) /\ i.incarnation = l.lives[me] /\ me \in l.members
      a == [s EXCEPT !.ledger = l, !.accepted = Nothing, !.by_all = NoneTorn, !.attempt = NoAttempt,
                     !.frozen_by = FALSE, !.moves = SelectSeq(@, still),
                     !.followers = IF mine THEN @ \ returned ELSE {}]
      let_in == \E i \in kept : i.entry = "Join" /\ i.by = me
      b == IF let_in /\ ~a.active /\ l.logs[me] = a.log_id
           THEN [a EXCEPT !.active = TRUE, !.amnesic = FALSE, !.torn = <<>>]
           ELSE IF let_in /\ a.active /\ ~is_our_name(p, a) THEN forget(p, a, TRUE) ELSE a
      c == IF b.active /\ spoken_for(p, b) THEN new_life(p, b) ELSE b
      leaves == me \in l.left /\ c.active /\ c.incarnation = l.lives[me]
  IN IF me \notin l.members /\ c.incarnation <= l.lives[me] /\ ~leaves
     THEN new_life(p, c) ELSE c

changes_members(items) == \E i \in Range(items) : i.entry \in {"Join", "Leave", "Evict"}

\* A decision that a robot may tell to others. Who tells it matters where somebody may not teach.
told(p, s, items) ==
  [slot |-> length(s.ledger), hash |-> hash(s.ledger), batch |-> news(s.ledger, items),
   by |-> IF Outages > 0 THEN name(p) ELSE NONE, log |-> IF Outages > 0 THEN s.log_id ELSE NONE]

\* All that its log holds: under its new id, the others learn it.
told_again(p, s) ==
  {[slot |-> k - 1, hash |-> SubSeq(s.ledger.log, 1, k - 1), batch |-> s.ledger.log[k],
    by |-> name(p), log |-> s.log_id] : k \in DOMAIN s.ledger.log}

(* ---- messages ------------------------------------------------------------- *)

Message(p, s, kind, ballot, frozen, torn_robots) ==
  [kind |-> kind, from |-> name(p), log |-> s.log_id, torn |-> s.torn,
   slot |-> length(s.ledger), hash |-> hash(s.ledger),
   ballot |-> ballot, frozen |-> frozen, by |-> torn_robots]
Prepare(p, s, a) == Message(p, s, "prepare", a.ballot, a.frozen, a.torn)
Accepted(p, s, ballot) == Message(p, s, "accepted", ballot, FALSE, NoneTorn)
Promise(p, s, m, vote) ==
  [kind |-> "promise", from |-> name(p), log |-> s.log_id, torn |-> s.torn,
   slot |-> length(s.ledger), hash |-> hash(s.ledger),
   ballot |-> m.ballot, vote |-> vote, accepted |-> s.accepted, items |-> s.moves]
Accept(p, s, ballot, batch, torn_robots) ==
  [kind |-> "accept", from |-> name(p), log |-> s.log_id, torn |-> s.torn,
   slot |-> length(s.ledger), hash |-> hash(s.ledger),
   ballot |-> ballot, batch |-> batch, by |-> torn_robots]

\* Whether the sender's votes count: Membership.hear. (Whose log is not known yet is heard first.)
comes_through(p, s, m) ==
  /\ m.from # name(p) /\ s.off[m.from] = -1
  /\ <<m.from, m.log>> \notin s.dead /\ ~is_cast_out(s.ledger, m.from)
\* It may have come before its sender's machine lost power.
came_through(p, s, m) ==
  comes_through(p, IF m.torn = <<>> THEN [s EXCEPT !.dead = {}] ELSE s, m)
counts(p, s, m) == comes_through(p, s, m) /\ known_log(s, m.from) = m.log /\ m.torn = <<>>
is_counted(m, torn_robots) ==
  m.torn = <<>> \/ (torn_robots[m.from] # <<>> /\ torn_robots[m.from][1] = m.log)
votes_in(p, s, torn_robots) ==
  \/ s.torn # <<>> /\ torn_robots[name(p)] # <<>> /\ torn_robots[name(p)][1] = s.log_id
  \/ may_vote(p, s)
is_open(s, m) == m.slot = length(s.ledger) /\ m.hash = hash(s.ledger)

note_torn(p, s, torn_robots) ==
  LET new(r) == r # name(p) /\ torn_robots[r] # <<>> /\ <<r, torn_robots[r][1]>> \notin s.dead IN
  [s EXCEPT
    !.peers_torn = [r \in Robot |-> IF new(r) THEN torn_robots[r] ELSE s.peers_torn[r]],
    !.dead = @ \union UNION {{<<r, torn_robots[r][k]>> : k \in 2..Len(torn_robots[r])} :
                               r \in {x \in Robot : new(x)}}]

(* ---- entries that wait to get into the log (proposals.py) ----------------- *)

\* The item number k that p announces next. "told_at" is the length of its log then.
Item(p, s, entry, robot, life, forced, k) ==
  [entry |-> entry, robot |-> robot, life |-> life, forced |-> forced,
   by |-> name(p), incarnation |-> s.incarnation, number |-> s.number + k, log |-> s.log_id,
   told_at |-> IF Assertions + GiveBacks > 0 THEN length(s.ledger) ELSE 0,
   before |-> IF Partial THEN s.moves ELSE <<>>]  \* its local transitions, which come first

announce(p, s, i, synced) ==
  /\ proposals' = proposals \union {i}
  /\ Step(p, [s EXCEPT !.number = i.number], {}, synced)

\* What an evicted robot wanted before it knew of its eviction by force is given up.
not_given_up(s, i) == is_cast_out(s.ledger, i.by) => i.told_at > s.ledger.cast_out[i.by]

available(s) == {i \in proposals : is_news(s.ledger, i) /\ not_given_up(s, i)}

asking(p, s) ==
  {i \in proposals : i.by = name(p) /\ i.log = s.log_id /\ is_news(s.ledger, i)
     /\ i.entry # "Evict"}

RECURSIVE eviction_items(_, _, _, _)
eviction_items(p, s, robots, k) ==
  IF robots = {} THEN <<>>
  ELSE LET r == SetMin(robots)
           old == {i \in available(s) : i.entry = "Evict" /\ i.forced /\ i.robot = r
                                        /\ i.life = s.off[r] /\ i.by = name(p)}
           i == IF old # {} THEN CHOOSE x \in old : TRUE
                ELSE Item(p, s, "Evict", r, s.off[r], TRUE, k)
       IN <<i>> \o eviction_items(p, s, robots \ {r}, k + 1)

(* ---- consensus.py: the proposer -------------------------------------------- *)

NextBallots(p, s) ==
  {<<c, name(p), s.log_id>> : c \in s.promised[1] + 1 .. MaxCounter}

\* What a proposer may try next, and with which counter. The code may put several entries into a
\* batch, and pass counters by; trace.tla allows both.
batches(s) == {<<i>> : i \in available(s)}
counters(s) == {s.promised[1] + 1}

\* A robot cannot return in the slot that evicts it by force: it does not know of the eviction.
\* Electorate.without_ghosts
RECURSIVE without_returns(_, _)
without_returns(items, off) ==
  IF items = <<>> THEN <<>>
  ELSE LET i == Head(items) IN
       IF i.entry = "Join" /\ i.by \in off
       THEN without_returns(SelectSeq(Tail(items), LAMBDA x : x.by # i.by \/ x.log # i.log), off)
       ELSE <<i>> \o without_returns(Tail(items), off)

\* What is decided without the robots that are said to be off.
forced_batches(p, s, accepted, off) ==
  {without_returns(accepted, off) \o eviction_items(p, s, off, 1)}

\* Something of ours waits, or of a robot that has no vote. (Others tell the leader: lead_on.)
wants(p, s) ==
  \/ s.frozen_by \/ s.moves # <<>>
  \/ \E i \in available(s) : i.by = name(p) \/ i.by \notin members(s) \/ i.entry = "Join"

\* The first phase. An attempt that runs may be given up at any time.
propose(p) ==
  LET s == state[p]
      t == needs_all(p, s)
  IN
  /\ up(p) /\ length(s.ledger) < MaxLength /\ wants(p, s)
  /\ may_vote(p, s) \/ t # NoneTorn
  /\ NextBallots(p, s) # {}
  /\ \E frozen \in IF Partial /\ Pauses + GiveBacks > 0 THEN BOOLEAN ELSE {FALSE},
        c \in counters(s) :
     LET ballot == <<c, name(p), s.log_id>>
         a == [phase |-> 1, ballot |-> ballot, frozen |-> frozen, torn |-> t]
     IN Step(p, [s EXCEPT !.promised = ballot, !.attempt = a, !.followers = {},
                          !.frozen_by = @ \/ frozen],
             {Prepare(p, s, a)}, t # NoneTorn)
  /\ UNCHANGED <<proposals, chosen, faults>>

\* Vote for our own batch, and ask the others. A robot that may decide alone does so at once.
second_phase(p, s, batch, items) ==
  LET a == s.attempt
      all == a.torn # NoneTorn
      v == [s EXCEPT !.accepted = <<a.ballot, batch>>, !.attempt.phase = 2,
                     !.by_all = a.torn]
  IN
  /\ proposals' = proposals \union items
  /\ IF may_choose(s, {name(p)}, batch, all)
     THEN /\ chosen' = chosen \union {told(p, s, batch)}
          /\ Step(p, commit(p, v, batch, TRUE), {}, changes_members(batch))
     ELSE /\ chosen' = chosen
          /\ Step(p, v, {Accept(p, s, a.ballot, batch, a.torn)}, all \/ changes_members(batch))

leads(p, s) ==
  ~Partial /\ s.promised[2] = name(p) /\ is_quorum(s.followers, members(s))

lead_on(p) ==
  LET s == state[p] IN
  /\ up(p) /\ length(s.ledger) < MaxLength
  /\ may_vote(p, s) /\ leads(p, s) /\ s.attempt.phase = 0 /\ needs_all(p, s) = NoneTorn
  /\ \E b \in batches(s) :
       second_phase(p, [s EXCEPT !.attempt = [NoAttempt EXCEPT !.ballot = s.promised]], b, {})
  /\ UNCHANGED faults

\* Which entries end the lives of members whose local transitions nobody has reported.
ends_life(s, i, unasked, strangers) ==
  \/ i.entry = "Evict" /\ i.robot \in unasked /\ i.life = s.ledger.lives[i.robot]
  \/ i.entry = "Join" /\ i.by \in unasked \intersect strangers /\ i.life > s.ledger.lives[i.by]

are_replaced(s, unasked, strangers, batch) ==
  unasked \subseteq {i.robot : i \in {j \in Range(news(s.ledger, batch)) :
                                        ends_life(s, j, unasked, strangers)}}

\* The orders that local transitions must not pass: state.is_control.
is_control(i) == i.entry \in {"Pause", "GiveBack"}

RECURSIVE moves_of(_, _)  \* of these robots, in their order
moves_of(robots, items) ==
  IF robots = {} THEN <<>>
  ELSE LET r == SetMin(robots) IN items[r] \o moves_of(robots \ {r}, items)

\* In partial synchronisation: the local transitions that were reported, then an entry, if any.
partial_batches(p, s, answers, answered, strangers) ==
  LET me == name(p)
      reported(r) == IF r = me THEN s.moves
                     ELSE LET own == {m.items : m \in {n \in answers : n.from = r}} IN
                          IF own = {} THEN <<>>
                          ELSE CHOOSE x \in own : \A y \in own : Len(y) <= Len(x)
      moves == moves_of(Robot, [r \in Robot |-> reported(r)])
      unasked == members(s) \ answered
      back(i) == i.entry = "Join" /\ ends_life(s, i, unasked, strangers)
      \* what a lost memory announced under the same incarnation would hide the return
      kept(i) == SelectSeq(moves \o i.before, LAMBDA x :
                   ~(back(i) /\ x.by = i.by /\ x.incarnation = i.incarnation /\ x.log # i.log))
      entries == {i \in available(s) : ~is_control(i) \/ s.attempt.frozen}
  IN {b \in {kept(i) \o <<i>> : i \in entries} \union {moves} :
        b # <<>> /\ (unasked = {} \/ are_replaced(s, unasked, strangers, b))}

first_phase_over(p) ==
  LET s == state[p]
      me == name(p)
      a == s.attempt
      all == a.torn # NoneTorn
      promises == {m \in sent : m.kind = "promise" /\ m.ballot = a.ballot /\ is_open(s, m)
                     /\ came_through(p, s, m)
                     /\ (~m.vote \/ m.torn # <<>> \/ known_log(s, m.from) = m.log)}
  IN
  /\ up(p) /\ a.phase = 1 /\ s.promised = a.ballot
  /\ \E answers \in SUBSET promises :
     LET voting == {m \in answers : m.vote /\ is_counted(m, a.torn)}
         voters == {me} \union {m.from : m \in voting}
         held == ({s.accepted} \union {m.accepted : m \in voting}) \ {Nothing}
         accepted == IF held = {} THEN <<>>
                     ELSE (CHOOSE x \in held : \A y \in held : ~less(x[1], y[1]))[2]
         off == not_cast_out(s, voters, <<>>, all)
         mine(m) == m.log = known_log(s, m.from) /\ m.torn = <<>>
         answered == (IF s.torn = <<>> THEN {me} ELSE {})
                       \union {m.from : m \in {n \in answers : mine(n)}}
         strangers == (IF s.torn = <<>> THEN {} ELSE {me})
                        \union {m.from : m \in {n \in answers : ~mine(n)}}
         after == [s EXCEPT !.followers = IF Partial \/ all THEN {} ELSE voters]
     IN
     /\ may_decide(s, voters, all)
     \* full synchronisation does not wait for more
     /\ Partial \/ voting = {} \/ \E m \in voting : ~may_decide(s, voters \ {m.from}, all)
     /\ IF off # {}
        THEN \E batch \in forced_batches(p, s, accepted, off) :
             LET new == Max(s.number, batch[Len(batch)].number)
             IN /\ not_cast_out(s, voters, batch, all) = {}
                /\ second_phase(p, [after EXCEPT !.number = new], batch,
                                Range(batch) \ Range(accepted))
        ELSE IF held # {} THEN second_phase(p, after, accepted, {})
        ELSE IF Partial
             THEN \E b \in partial_batches(p, s, answers, answered, strangers) :
                    second_phase(p, after, b, {})
             ELSE \E b \in batches(s) : second_phase(p, after, b, {})
  /\ UNCHANGED faults

(* ---- consensus.py: the acceptor --------------------------------------------- *)

on_prepare(p, m) ==
  LET s == note_torn(p, state[p], m.by)
      vote == votes_in(p, s, m.by)
  IN
  /\ m.kind = "prepare" /\ up(p)
  /\ counts(p, s, m) \/ (m.torn # <<>> /\ comes_through(p, s, m))
  /\ is_counted(m, m.by) /\ is_open(s, m)
  /\ IF vote
     THEN /\ ~less(m.ballot, s.promised)
          /\ LET t == [s EXCEPT !.promised = m.ballot, !.followers = {},
                                !.frozen_by = @ \/ m.frozen,
                                !.attempt = IF @.phase = 1 /\ less(@.ballot, m.ballot)
                                            THEN NoAttempt ELSE @]
             IN Step(p, t, {Promise(p, t, m, TRUE)}, m.by # NoneTorn)
     ELSE /\ Partial
          /\ LET t == [s EXCEPT !.frozen_by = @ \/ m.frozen]
             IN Step(p, t, {Promise(p, t, m, FALSE)}, m.by # NoneTorn)
  /\ UNCHANGED <<proposals, chosen, faults>>

on_accept(p, m) ==
  LET s == note_torn(p, state[p], m.by)
      held == s.accepted
      confirms == held # Nothing /\ held[1] = m.ballot /\ m.slot = length(s.ledger) + 1
      t == IF confirms THEN commit(p, s, held[2], FALSE) ELSE s
      votes == is_open(t, m) /\ votes_in(p, t, m.by) /\ ~less(m.ballot, t.promised)
      new == t.accepted = Nothing \/ t.accepted[1] # m.ballot
      u == [t EXCEPT !.promised = m.ballot, !.accepted = <<m.ballot, m.batch>>,
                     !.by_all = m.by, !.followers = {},
                     !.attempt = IF @.phase > 0 /\ less(@.ballot, m.ballot) THEN NoAttempt ELSE @]
  IN
  /\ m.kind = "accept" /\ up(p)
  /\ counts(p, s, m) \/ (m.torn # <<>> /\ comes_through(p, s, m))
  /\ is_counted(m, m.by)
  /\ confirms \/ votes
  /\ chosen' = IF confirms THEN chosen \union {told(p, s, held[2])} ELSE chosen
  /\ IF votes
     THEN Step(p, IF new THEN u ELSE t, {Accepted(p, t, m.ballot)},
               m.by # NoneTorn \/ changes_members(m.batch))
     ELSE Step(p, t, {}, m.by # NoneTorn)
  /\ UNCHANGED <<proposals, faults>>

\* Enough votes for what we accepted have come.
decide_if_chosen(p) ==
  LET s == state[p]
      ballot == s.accepted[1]
      all == s.by_all # NoneTorn
      \* a vote may have come before its sender was asserted to be off
      votes == {m \in sent : m.kind = "accepted" /\ m.ballot = ballot /\ is_open(s, m)
                  /\ m.from # name(p) /\ <<m.from, m.log>> \notin s.dead
                  /\ ~is_cast_out(s.ledger, m.from)
                  /\ (m.torn = <<>> => known_log(s, m.from) = m.log)
                  /\ is_counted(m, s.by_all)}
  IN
  /\ up(p) /\ s.accepted # Nothing
  /\ may_choose(s, {name(p), ballot[2]} \union {m.from : m \in votes}, s.accepted[2], all)
  /\ chosen' = chosen \union {told(p, s, s.accepted[2])}
  /\ Step(p, commit(p, s, s.accepted[2], s.attempt.phase = 2 /\ s.attempt.ballot = ballot),
          {}, FALSE)
  /\ UNCHANGED <<proposals, faults>>

(* ---- replication.py ----------------------------------------------------------- *)

on_learn(p, c) ==
  LET s == state[p] IN
  /\ up(p) /\ c.slot = length(s.ledger) /\ c.hash = hash(s.ledger)
  /\ c.by # NONE => c.by # name(p) /\ can_teach(s, c.by) /\ <<c.by, c.log>> \notin s.dead
  /\ chosen' = chosen \union {told(p, s, c.batch)}
  /\ Step(p, commit(p, s, c.batch, FALSE), {}, FALSE)
  /\ UNCHANGED <<proposals, faults>>

(* ---- membership.py -------------------------------------------------------------- *)

\* Hear a hello of robot r, sent with log id: the first log that we hear of counts.
hear(p, r, id) ==
  LET s == state[p] IN
  /\ up(p) /\ r # name(p) /\ s.off[r] = -1
  /\ IF known_log(s, r) = NONE
     THEN Step(p, [s EXCEPT !.known[r] = id,
                            !.unsure = IF s.amnesic THEN @ \union {r} ELSE @ \ {r}], {}, TRUE)
     ELSE /\ r \in s.unsure /\ <<r, id>> \in took_part
          /\ Step(p, [s EXCEPT !.known[r] = id, !.unsure = @ \ {r}], {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>

hear_of_ourselves(p, m) ==
  LET s == state[p]
      begun == length(s.ledger) > 0
      known == known_log(s, m.from)
      witness == ~begun \/ known \in {m.log} \union Range(m.torn)
      t == [s EXCEPT !.welcomes[m.from] = IF m.seen = s.log_id THEN m.length ELSE -1]
  IN
  /\ m.kind = "hello" /\ m.to = name(p) /\ up(p) /\ known # NONE /\ witness
  /\ ~has_to_join(s)
  /\ IF m.seen # s.log_id /\ s.ledger.logs[name(p)] # s.log_id
     THEN Step(p, forget(p, t, FALSE), {}, TRUE)
     ELSE t # s /\ ~s.active /\ Step(p, t, {}, FALSE)
  /\ UNCHANGED <<proposals, chosen, faults>>

\* Take part, because every other robot knows our log as our first one.
consider_active(p) ==
  LET s == state[p]
      lead == SetMin(members(s)) = name(p) /\ s.incarnation = 0 /\ length(s.ledger) = 0
              /\ ~Partial
  IN
  /\ up(p) /\ ~s.active /\ ~s.amnesic
  /\ \A r \in witnesses_of_start(p, s) : s.welcomes[r] \in 0..length(s.ledger)
  /\ IF acted_before(p, s)
     THEN Step(p, forget(p, s, FALSE), {}, TRUE)
     ELSE Step(p, [s EXCEPT !.active = TRUE,
                            !.followers = IF lead THEN {r \in members(s) : s.off[r] = -1} ELSE @],
               {}, FALSE)
  /\ UNCHANGED <<proposals, chosen, faults>>

want_to_join(p) ==
  LET s == state[p]
      t == IF s.started = s.incarnation \/ known_incarnation(p, s) >= s.incarnation
           THEN new_life(p, s) ELSE s
      i == Item(p, t, "Join", name(p), t.incarnation, FALSE, 1)
  IN
  /\ up(p) /\ (s.active \/ s.amnesic)
  /\ ~is_settled(p, s)
  /\ ~\E j \in proposals : j.entry = "Join" /\ j.by = name(p) /\ j.log = t.log_id
                           /\ j.life = t.incarnation
  /\ announce(p, t, i, t # s)
  /\ UNCHANGED <<chosen, faults>>

\* A process starts under the name of a robot, without a log.
Spare(p) ==
  /\ ~up(p)
  /\ Step(p, Fresh(new_id(p)), {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>

\* A process ends, and starts again with its log: Recovery.resume.
resume(p) ==
  LET s == without_memory(state[p])
      t == IF s.active /\ ~is_our_name(p, s) THEN forget(p, s, TRUE) ELSE s
  IN
  /\ up(p) /\ Fault("Restarts")
  /\ Step(p, new_life(p, [t EXCEPT !.begin_records = @ + 1]), {}, TRUE)
  /\ UNCHANGED <<proposals, chosen>>

\* ... without its log.
LoseLog(p) ==
  /\ up(p) /\ Fault("Losses")
  /\ Step(p, Fresh(new_id(p)), {}, TRUE)
  /\ UNCHANGED <<proposals, chosen>>

\* The power fails, and what was not on the disk is lost: Membership._lose_end.
outlive_outage(p) ==
  LET s == disk[p]
      t == IF s.amnesic /\ s.torn = <<>> THEN forget(p, s, FALSE)
           ELSE [s EXCEPT !.torn = <<s.log_id>> \o @, !.active = FALSE, !.amnesic = TRUE,
                          !.log_id = new_id(p), !.begin_records = @ + 1]
  IN
  /\ up(p) /\ Fault("Outages")
  /\ Step(p, new_life(p, t), {}, TRUE)
  /\ chosen' = chosen \union told_again(p, t)
  /\ UNCHANGED proposals

\* The thread that brings the log to the disk has done so.
Sync(p) ==
  /\ Outages > 0 /\ up(p) /\ faults["Outages"] > 0 /\ disk[p] # without_memory(state[p])
  /\ disk' = [disk EXCEPT ![p] = without_memory(state[p])]
  /\ UNCHANGED <<state, sent, proposals, chosen, log_ids, took_part, acted, faults>>

\* Hear that robot r's machine lost power.
hear_torn(p, q) ==
  LET s == state[p]
      r == name(q)
      t == note_torn(p, s, [NoneTorn EXCEPT ![r] = <<state[q].log_id>> \o state[q].torn])
  IN
  /\ up(p) /\ up(q) /\ name(p) # r /\ state[q].torn # <<>> /\ t # s
  /\ Step(p, t, {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>

\* Nobody has heard r for a while: Membership.watch.
watch(p, r) ==
  LET s == state[p] IN
  /\ up(p) /\ may_vote(p, s) /\ r \in members(s) \ {name(p)} /\ Fault("Evictions")
  /\ announce(p, s, Item(p, s, "Evict", r, s.ledger.lives[r], FALSE, 1), FALSE)
  /\ UNCHANGED chosen

\* An operator asserts that r is off, right or wrong.
evict_by_force(p, r) ==
  LET s == state[p]
      t == [s EXCEPT !.off[r] = s.ledger.lives[r], !.attempt = NoAttempt, !.followers = {}]
  IN
  /\ up(p) /\ s.active /\ r \in members(s) \ {name(p)} /\ s.off[r] = -1 /\ Fault("Assertions")
  /\ announce(p, t, Item(p, t, "Evict", r, t.off[r], TRUE, 1), TRUE)
  /\ UNCHANGED chosen

heard_though_off(p, r) ==
  LET s == state[p] IN
  /\ up(p) /\ s.off[r] # -1
  /\ Step(p, [s EXCEPT !.off[r] = -1, !.attempt = NoAttempt, !.followers = {}], {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>

\* Membership._is_given_up: whether the log of robot "owner", with these evictions by force, was
\* given up by those of another log.
is_given_up(owner, one, long, other) ==
  LET by_one == {r \in Robot : one[r] > other[r]}
      by_other == {r \in Robot : other[r] > one[r]}
      new == {r \in by_other : r = owner \/ one[r] = -1}
  IN IF by_one = {} THEN \E r \in new : other[r] < long
     ELSE IF Cardinality(by_one) # Cardinality(by_other)
     THEN Cardinality(by_one) > Cardinality(by_other) /\ by_other # {}
     ELSE SetMin(by_one \union by_other) \in by_one

forget_given_up(p, q) ==
  LET s == state[p]
      l == state[q].ledger
  IN
  /\ Assertions > 0 /\ up(p) /\ up(q) /\ name(p) # name(q) /\ s.off[name(q)] = -1
  /\ is_given_up(name(p), s.ledger.cast_out, length(s.ledger), l.cast_out)
  /\ Step(p, forget(p, s, FALSE), {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>

prefixes(a, b) == \A k \in 1..Len(a) : k <= Len(b) => a[k] = b[k]

\* A robot outside the team that sees that its log differs from that of another one.
conflict(p, q) ==
  LET s == state[p]
      l == state[q].ledger
  IN
  /\ Assertions + Outages > 0 /\ up(p) /\ up(q) /\ name(p) # name(q)
  /\ ~s.active /\ ~(s.torn # <<>> /\ name(p) \in members(s))
  /\ s.off[name(q)] = -1 /\ ~is_cast_out(s.ledger, name(q))
  /\ ~prefixes(s.ledger.log, l.log)
  /\ Step(p, forget(p, s, FALSE), {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>

(* ---- local_robot.py ------------------------------------------------------------- *)

\* A robot leaves a private place: add_local_transition.
move_alone(p) ==
  LET s == state[p]
      i == Item(p, [s EXCEPT !.moves = <<>>], "Move", name(p), s.incarnation, FALSE, 1)
  IN
  /\ Partial /\ up(p) /\ is_settled(p, s) /\ ~s.frozen_by /\ ~s.ledger.paused
  /\ asking(p, s) = {} /\ Fault("Moves")
  /\ Step(p, [s EXCEPT !.moves = Append(@, i), !.number = i.number], {}, FALSE)
  /\ UNCHANGED <<proposals, chosen>>

\* An operator orders a pause.
order_pause(p) ==
  LET s == state[p] IN
  /\ up(p) /\ is_settled(p, s) /\ Fault("Pauses")
  /\ announce(p, s, Item(p, s, "Pause", name(p), 0, FALSE, 1), FALSE)
  /\ UNCHANGED chosen

\* A task is taken from robot r: given back, cancelled, or replaced by another one.
give_back(p, r) ==
  LET s == state[p] IN
  /\ up(p) /\ is_settled(p, s) /\ r \in members(s) /\ Fault("GiveBacks")
  /\ announce(p, s, Item(p, s, "GiveBack", r, 0, FALSE, 1), FALSE)
  /\ UNCHANGED chosen

(* ---- all behaviours --------------------------------------------------------------- *)

FirstItem(r) ==
  [entry |-> "Done", robot |-> r, life |-> 0, forced |-> FALSE,
   by |-> r, incarnation |-> 0, number |-> 1, log |-> 1, told_at |-> 0, before |-> <<>>]

InitialState(p) ==
  IF p[2] = 1 THEN Fresh(NONE)
  ELSE [Fresh(1) EXCEPT
    !.number = IF name(p) \in Wants THEN 1 ELSE 0,
    !.active = Begun,
    !.started = IF Begun THEN 0 ELSE -1,
    !.known = [r \in Robot |-> IF Begun /\ r # name(p) THEN 1 ELSE NONE],
    !.followers = IF Begun /\ name(p) = 1 /\ ~Partial THEN Robot ELSE {}]

Init ==
  /\ state = [p \in Process |-> InitialState(p)]
  /\ disk = IF Outages > 0 THEN [p \in Process |-> without_memory(state[p])] ELSE <<>>
  /\ sent = greetings(state) /\ chosen = {}
  /\ proposals = {FirstItem(r) : r \in Wants}
  /\ log_ids = [r \in Robot |-> 1]
  /\ took_part = IF Begun /\ (Losses > 0 \/ Spares # {}) THEN Robot \X {1} ELSE {}
  /\ acted = IF Begun THEN {<<r, 0, 1, 0>> : r \in Robot} ELSE {}
  /\ faults = [f \in {"Restarts", "Losses", "Outages", "Evictions", "Assertions", "Moves", "Pauses",
                     "GiveBacks"}
                |-> CASE f = "Restarts" -> Restarts
                      [] f = "Losses" -> Losses
                      [] f = "Outages" -> Outages
                      [] f = "Evictions" -> Evictions
                      [] f = "Assertions" -> Assertions
                      [] f = "Moves" -> Moves
                      [] f = "Pauses" -> Pauses
                      [] f = "GiveBacks" -> GiveBacks]

Next == \E p \in Process :
  \/ propose(p) \/ lead_on(p) \/ first_phase_over(p) \/ decide_if_chosen(p)
  \/ \E m \in sent : on_prepare(p, m)
  \/ \E m \in sent : on_accept(p, m)
  \/ \E m \in sent : hear_of_ourselves(p, m)
  \/ \E c \in chosen : on_learn(p, c)
  \/ \E r \in Robot : \E id \in 1..log_ids[r] : hear(p, r, id)
  \/ consider_active(p) \/ want_to_join(p)
  \/ \E r \in Robot : watch(p, r)
  \/ \E r \in Robot : evict_by_force(p, r)
  \/ \E r \in Robot : heard_though_off(p, r)
  \/ Spare(p) \/ resume(p) \/ LoseLog(p) \/ outlive_outage(p) \/ Sync(p)
  \/ \E q \in Process : hear_torn(p, q)
  \/ \E q \in Process : forget_given_up(p, q)
  \/ \E q \in Process : conflict(p, q)
  \/ move_alone(p) \/ order_pause(p)
  \/ \E r \in Robot : give_back(p, r)

Spec == Init /\ [][Next]_vars

(* ---- what must hold ----------------------------------------------------------------- *)

forced_out(batch) == {i.robot : i \in {j \in Range(batch) : j.entry = "Evict" /\ j.forced}}

\* No two different decided values of a slot. Logs part only where one of them evicts by force.
\* (A loss of power may take a slot from all who knew it; the next two say what stays then.)
Agreement ==
  Outages = 0 => \A c, d \in chosen :
    c.slot = d.slot /\ c.hash = d.hash /\ c.batch # d.batch =>
      Assertions > 0 /\ forced_out(c.batch) \union forced_out(d.batch) # {}

\* The logs of those who have a vote are one log, after a loss of power, too.
MembersAgree ==
  Assertions = 0 =>
    \A p, q \in Process :
      may_vote(p, state[p]) /\ may_vote(q, state[q]) =>
        prefixes(state[p].ledger.log, state[q].ledger.log)

\* What a robot knew to be decided, and had on its disk, stays, as long as it is a member.
NothingAcknowledgedIsLost ==
  Assertions = 0 =>
    \A p, q \in Process :
      LET known == IF Outages > 0 THEN disk[p] ELSE state[p] IN
      up(p) /\ may_vote(q, state[q]) /\ name(p) \in members(state[q]) =>
        prefixes(known.ledger.log, state[q].ledger.log)

\* No slot sees the votes of two memories of a robot.
OneMemoryVotes ==
  \A m, n \in sent :
    m.kind \in {"accept", "accepted"} /\ n.kind \in {"accept", "accepted"}
      /\ m.from = n.from /\ m.slot = n.slot
      /\ m.torn = <<>> /\ n.torn = <<>> => m.log = n.log

\* No two lives of a robot act in one incarnation: names of actions are unique.
OneLifeActs ==
  \A a, b \in acted : a[1] = b[1] /\ a[2] = b[2] => a = b

\* Who votes knows that it promised at least the ballot of its vote.
PromisesAreKept ==
  \A p \in Process :
    LET s == state[p] IN s.accepted # Nothing => ~less(s.promised, s.accepted[1])

\* No local transition passes an order for which all of them hold still: the life that made it has
\* it in the log before, or has ended.
NoMovePassesAPause ==
  \A p, q \in Process :
    LET l == state[q].ledger
        s == state[p]
    IN l.paused /\ up(p) /\ s.active =>
         \A k \in DOMAIN s.moves :
           LET i == s.moves[k] IN
           ~(is_news(l, i) /\ i.incarnation = l.lives[name(p)] /\ name(p) \in l.members
              /\ known_log(state[q], name(p)) = i.log)

\* What a robot did alone, before it knew that its task was taken from it, is in the log before.
NoMoveIsTakenBack ==
  \A p, q \in Process :
    LET l == state[q].ledger
        s == state[p]
        at == l.sent_away[name(p)]
    IN at >= 0 /\ up(p) /\ s.active =>
         \A k \in DOMAIN s.moves :
           LET i == s.moves[k] IN
           ~(i.told_at <= at /\ is_news(l, i) /\ i.incarnation = l.lives[name(p)]
              /\ name(p) \in l.members /\ known_log(state[q], name(p)) = i.log)

\* Local transitions get into the log in the order in which they were made, and none between is lost.
MovesInOrder ==
  \A p \in Process :
    LET l == state[p].ledger.log
        all == UNION {Range(l[k]) : k \in DOMAIN l}
    IN \A q \in Process : \A k \in DOMAIN state[q].moves :
         LET i == state[q].moves[k] IN
         \A j \in all : j.by = i.by /\ j.incarnation = i.incarnation /\ j.log = i.log
                          => j.number < i.number \/ i \in all
=============================================================================
