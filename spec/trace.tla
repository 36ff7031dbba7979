-------------------------------- MODULE trace --------------------------------
(* Whether the specification allows what replicas did: test/agreement/traces.py writes their steps *)
(* as Traces, in a module traces. Each step has to be one of an action of agreement.tla, after which the process knows *)
(* what the replica knew. TLC prints how far it comes, and what differs.                           *)
EXTENDS agreement, TLC, traces

VARIABLES trace, at  \* the number of the trace, and of the step that comes next

step == Traces[trace][at]

\* All entries of the trace wait from the beginning; who proposes which of them, and when, is free.
TraceBatches(s) == {b \in {step.batch} : b # <<>> /\ Range(b) \subseteq available(s)}
TraceCounters(s) == {c \in {step.ballot[1]} : c > s.promised[1]}
TraceWants(p, s) == TRUE
\* The numbers of a robot's entries are those of the trace, not of its state.
TraceSpokenFor(p, s) == known_incarnation(p, s) > s.incarnation

Entries(t) == UNION {Range(Traces[t][k].batch) : k \in DOMAIN Traces[t]}

TraceInit ==
  /\ Init
  /\ trace \in DOMAIN Traces /\ at = 1

TraceStart ==
  /\ at = 1 /\ proposals = {} /\ Traces[trace] # <<>>
  /\ proposals' = Entries(trace)
  /\ UNCHANGED <<state, disk, sent, chosen, log_ids, took_part, acted, faults, trace, at>>

Same(field, specified, found) ==
  specified = found \/ (PrintT(<<"differs", trace, at, field, specified, found>>) /\ FALSE)

took(p) ==
  CASE step.what = "resume" -> resume(p)
    [] step.what = "propose" -> propose(p)
    [] step.what = "promise" ->
         \E m \in {n \in sent : n.kind = "prepare" /\ n.ballot = step.ballot} : on_prepare(p, m)
    [] step.what = "second_phase" -> first_phase_over(p) \/ lead_on(p)
    [] step.what = "vote" ->
         \E m \in {n \in sent : n.kind = "accept" /\ n.ballot = step.ballot /\ n.slot = step.length} :
           on_accept(p, m)
    [] step.what = "decide" ->
         \/ decide_if_chosen(p)
         \/ first_phase_over(p) \/ lead_on(p)  \* alone: the vote and the decision are one step
         \/ \E c \in {d \in chosen : d.slot = step.length - 1} : on_learn(p, c)

knows(s) ==
  /\ Same("length", length(s.ledger), step.length)
  /\ Same("promised", s.promised, step.promised)
  /\ Same("accepted", s.accepted, step.accepted)
  /\ step.what = "resume" => Same("incarnation", s.incarnation, step.incarnation)
  /\ step.what = "decide" => Same("decided", s.ledger.log[step.length], step.batch)

TraceNext ==
  \/ TraceStart
  \/ /\ proposals # {} /\ at <= Len(Traces[trace])
     /\ LET p == <<step.robot, 0>> IN took(p) /\ knows(state'[p])
     /\ at' = at + 1 /\ UNCHANGED trace
     /\ PrintT(<<"took", trace, at>>)

TraceSpec == TraceInit /\ [][TraceNext]_<<vars, trace, at>>
=============================================================================
