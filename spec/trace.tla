-------------------------------- MODULE trace --------------------------------
(* Whether the specification allows what replicas did: test/agreement/traces.py writes their steps *)
(* as Traces, in a module traces. Each step has to be one of an action of agreement.tla, after     *)
(* which the process knows what the replica knew. TLC prints how far it comes, and what differs.   *)
EXTENDS agreement, TLC, traces

CONSTANT Holds  \* whether the traces say who answers without a vote, and when a robot holds still

VARIABLES trace, at  \* the number of the trace, and of the step that comes next

step == Traces[trace][at]

Same(field, specified, found) ==
  specified = found \/ (PrintT(<<"differs", trace, at, field, specified, found>>) /\ FALSE)

\* All entries of the trace wait from the beginning; who proposes which of them, and when, is free.
TraceBatches(s) == {b \in {step.batch} : b # <<>> /\ Range(b) \subseteq available(s)}
\* What was accepted comes first, but for robots that return and are off or not heard, and for the
\* departure of the last one.
TraceForcedBatches(p, s, accepted, off) ==
  LET kept == SelectSeq(accepted, LAMBDA i : i \in Range(step.batch))
      may_go(i) ==
        \/ i.entry \in {"Leave", "Evict"} /\ i.robot = name(p)
        \/ \E j \in Range(accepted) : j.entry = "Join" /\ j.by = i.by /\ j.log = i.log
                                     /\ (j.by \in off \/ j.by \notin members(s))
  IN {b \in {step.batch} :
        /\ Len(b) > Len(kept) /\ SubSeq(b, 1, Len(kept)) = kept
        /\ \A i \in Range(accepted) \ Range(b) : may_go(i)
        /\ \A i \in Range(b) \ Range(accepted) : i.entry = "Move" \/ i \in available(s)}
\* The trace does not say what robots knew when they proposed something.
TraceNotGivenUp(s, i) == TRUE
TraceCounters(s) == {c \in {step.ballot[1]} : c > s.promised[1]}
TraceWants(p, s) == TRUE
\* The numbers of a robot's entries are those of the trace, not of its state.
TraceSpokenFor(p, s) == known_incarnation(p, s) > s.incarnation

\* In partial synchronisation, a proposer puts every local transition that was reported to it into
\* the batch, in order, and an order only if all hold still. The code may propose nothing, too.
inside(items, batch) == SelectSeq(batch, LAMBDA i : i \in Range(items)) = items
TracePartialBatches(p, s, answers, answered, strangers) ==
  LET unasked == members(s) \ answered
      reported == {s.moves} \union {m.items : m \in answers}
      b == step.batch
  IN {x \in {b} :
        /\ \A items \in reported : inside(SelectSeq(items, LAMBDA i : is_news(s.ledger, i)), b)
        /\ \A i \in Range(b) : i \in available(s) /\ (is_control(i) => s.attempt.frozen)
        /\ ~Holds \/ unasked = {} \/ are_replaced(s, unasked, strangers, b)}

\* A local transition is the one of the trace, of the life and the log that the robot has.
TraceAsking(p, s) == {}
TraceItem(p, s, entry, robot, life, forced, k) == step.batch[1]
of_this_life(s, i) ==
  Same("origin", <<i.by, i.incarnation, i.log>>, <<step.robot, s.incarnation, s.log_id>>)

\* A greeting, and that the robot forgets because of it, are one step. So are a new life and its Join
\* in the specification, but here the Join waits from the beginning.
forgets(p) ==
  LET s == state[p] IN
  /\ \/ acted_before(p, s)
     \/ /\ s.ledger.logs[name(p)] # s.log_id
        /\ \E r \in Robot \ {name(p)} :
             known_log(state[<<r, 0>>], name(p)) \notin {NONE, s.log_id}
  /\ Step(p, forget(p, s, FALSE), {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>
\* An operator says here that a robot is off, or the robot hears from others that one did.
hears_off(p, r, here) ==
  LET s == state[p]
      t == [s EXCEPT !.off[r] = s.ledger.lives[r]] IN
  /\ up(p) /\ r \in members(s) \ {name(p)} /\ (here \/ ~s.active)
  /\ Step(p, IF here THEN [t EXCEPT !.attempt = NoAttempt, !.followers = {}] ELSE t, {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>
hears_though_off(p, r) ==
  LET s == state[p] IN
  IF r \in asserted_off(s) THEN heard_though_off(p, r)
  ELSE Step(p, [s EXCEPT !.off[r] = -1], {}, TRUE) /\ UNCHANGED <<proposals, chosen, faults>>
\* The step that a loss of power later shows to be the last one on the disk.
syncs(p) ==
  /\ disk' = [disk EXCEPT ![p] = without_memory(state[p])]
  /\ UNCHANGED <<state, sent, proposals, chosen, log_ids, took_part, acted, faults>>
hears_torn(p, r) ==
  /\ step.ids[1] <= state[<<r, 0>>].log_id
  /\ Step(p, note_torn(p, state[p], [NoneTorn EXCEPT ![r] = step.ids]), {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>
lives_anew(p) ==
  /\ ~is_settled(p, state[p])
  /\ Step(p, new_life(p, state[p]), {}, TRUE)
  /\ UNCHANGED <<proposals, chosen, faults>>

\* A robot that does not take part yet says what it knows, without a vote; here all take part.
answer(p, m) ==
  LET t == [note_torn(p, state[p], m.by) EXCEPT !.frozen_by = @ \/ m.frozen] IN
  /\ Partial /\ (counts(p, t, m) \/ (m.torn # <<>> /\ comes_through(p, t, m)))
  /\ is_counted(m, m.by) /\ is_open(t, m)
  /\ Step(p, t, {Promise(p, t, m, FALSE)}, m.by # NoneTorn)
  /\ UNCHANGED <<proposals, chosen, faults>>

Entries(t) == UNION {Range(Traces[t][k].batch) : k \in DOMAIN Traces[t]}

TraceInit ==
  /\ Init
  /\ trace \in DOMAIN Traces /\ at = 0

TraceStart ==
  /\ at = 0 /\ at' = 1
  /\ proposals' = Entries(trace)
  /\ UNCHANGED <<state, disk, sent, chosen, log_ids, took_part, acted, faults, trace>>

took(p) ==
  CASE step.what = "resume" -> resume(p)
    [] step.what = "lose" -> LoseLog(p)
    [] step.what = "hear" -> hear(p, step.ballot[2], step.ballot[1])
    [] step.what = "forget" ->
         forgets(p) \/ \E q \in Process : forget_given_up(p, q) \/ conflict(p, q)
    [] step.what = "sync" -> syncs(p)
    [] step.what = "outage" -> outlive_outage(p)
    [] step.what = "torn" -> hears_torn(p, step.ballot[2])
    [] step.what = "active" -> consider_active(p)
    [] step.what = "assert" -> hears_off(p, step.ballot[2], TRUE)
    [] step.what = "note_off" -> hears_off(p, step.ballot[2], FALSE)
    [] step.what = "heard" -> hears_though_off(p, step.ballot[2])
    [] step.what = "new_life" -> lives_anew(p)
    [] step.what = "move" -> of_this_life(state[p], step.batch[1]) /\ move_alone(p)
    [] step.what = "propose" -> propose(p) /\ (Partial => state'[p].attempt.frozen = step.frozen)
    [] step.what = "promise" ->
         \E m \in {n \in sent : n.kind = "prepare" /\ n.ballot = step.ballot} : on_prepare(p, m)
    [] step.what = "answer" ->
         \E m \in {n \in sent : n.kind = "prepare" /\ n.ballot = step.ballot} : answer(p, m)
    [] step.what = "second_phase" -> first_phase_over(p) \/ lead_on(p)
    [] step.what = "vote" ->
         \E m \in {n \in sent : n.kind = "accept" /\ n.ballot = step.ballot /\ n.slot = step.length} :
           on_accept(p, m)
    [] step.what = "decide" ->
         \/ decide_if_chosen(p)
         \/ first_phase_over(p) \/ lead_on(p)  \* alone: the vote and the decision are one step
         \/ \E c \in {d \in chosen : d.slot = step.length - 1} : on_learn(p, c)

knows(s) ==
  /\ Holds => Same("frozen", s.frozen_by, step.frozen)
  /\ Same("length", length(s.ledger), step.length)
  /\ Same("promised", s.promised, step.promised)
  /\ Same("accepted", s.accepted, step.accepted)
  /\ step.what \in {"resume", "new_life", "outage"} => Same("incarnation", s.incarnation, step.incarnation)
  /\ step.what = "decide" => Same("decided", s.ledger.log[step.length], step.batch)

(* Tasks. Whom the token game gives a task is left out here; but it may not do to a task what the   *)
(* entries of the slot do not say. A step has <<task, "waits", robot>> for each that is not done    *)
(* (robot 0: for none that is with a robot), and <<task, how it ended, after how many other ends>>. *)

\* What the first robot had that knew this log. (Logs have numbers, since they part if somebody says
\* wrongly that robots are off; 0 is the one without slots.)
tasks_after(log) ==
  IF log = 0 THEN {}
  ELSE LET steps == Traces[trace] IN
       steps[SetMin({k \in DOMAIN steps : steps[k].what = "decide" /\ steps[k].log = log})].tasks

says(batch, part) == UNION {i[part] : i \in Range(batch)}

\* What becomes of a task that was x, in a slot with this batch.
may_become(x, y, batch) ==
  LET by_its_robot == \E i \in Range(batch) : i.by = x[3]
      of_its_robot == \E i \in Range(batch) : i.entry \in {"Join", "Evict"} /\ i.robot = x[3]
  IN
  \/ x[2] = "waits" /\ y[2] \in {"cancelled", "late"} /\ x[1] \in says(batch, "ends")
  \/ x[2] = "waits" /\ y[2] \in {"done", "lost"} /\ x[3] # 0 /\ by_its_robot
  \/ x[2] = "waits" /\ y[2] = "waits"
     /\ \/ x[3] \in {0, y[3]} \/ by_its_robot \/ of_its_robot
        \/ x[1] \in says(batch, "frees") \union says(batch, "makes")

\* A task is in one place or has ended, once; it came in, and never goes without a word.
lawful(before, batch, after) ==
  /\ \A x, y \in after : x[1] = y[1] => x = y
  /\ \A x \in before : x \in after \/ \E y \in after : x[1] = y[1] /\ may_become(x, y, batch)
  /\ \A y \in after : (\E x \in before : x[1] = y[1]) \/ {y[1], 0} \cap says(batch, "makes") # {}

keeps_tasks ==
  /\ Same("tasks", tasks_after(step.log), step.tasks)
  /\ Same("lawful", TRUE, lawful(tasks_after(step.base), step.batch, step.tasks))

TraceNext ==
  \/ TraceStart
  \/ /\ at \in 1..Len(Traces[trace])
     /\ LET p == <<step.robot, 0>> IN took(p) /\ IF step.what = "sync" THEN TRUE ELSE knows(state'[p])
     /\ step.what = "decide" => keeps_tasks
     /\ at' = at + 1 /\ UNCHANGED trace
     /\ PrintT(<<"took", trace, at>>)

TraceSpec == TraceInit /\ [][TraceNext]_<<vars, trace, at>>
=============================================================================
