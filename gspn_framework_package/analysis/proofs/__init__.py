"""Questions about all markings that a net or a plan can reach, decided without visiting them all.

Modules: ``ladder`` (decides a question, step by step), ``questions`` (what is asked, as facts about
markings; with ``conditions`` and ``policy_rows`` as inequalities, and ``returning`` for what can be
reached again), ``prover``, ``homing``, ``inductive`` and ``witness`` (search for proofs, for ways
home, for invariants with z3, and for firings that lead to a marking), ``checker`` (checks proofs,
and needs neither NumPy nor a solver), ``answers`` (what they add to a report).
"""
