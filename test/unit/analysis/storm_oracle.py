"""The model checker Storm as an independent oracle: the same net through its own GSPN translation and checkers."""

import stormpy
from stormpy import environments, gspn, transformations


def storm_jani(net, clock):
    """The net as a JANI model that Storm made itself; with a clock that never stops on the side, if wanted."""
    builder = gspn.GspnBuilder()
    builder.set_gspn_name("net")
    for place in net.places:
        builder.add_place(None, place.tokens, place.name)  # Storm's translation does not enforce capacities
    for t, transition in enumerate(net.transitions):
        if transition.timed:
            builder.add_timed_transition(0, transition.rate, transition.servers, transition.name)
        else:
            builder.add_immediate_transition(transition.priority, transition.weight, transition.name)
        for p, weight in net.inputs[t]:
            builder.add_input_arc(net.places[p].name, transition.name, weight)
        for p, weight in net.outputs[t]:
            builder.add_output_arc(transition.name, net.places[p].name, weight)
        for p, weight in net.inhibitors[t]:
            builder.add_inhibition_arc(net.places[p].name, transition.name, weight)
        for p, change in net.effect(t):
            capacity = net.places[p].capacity
            if capacity is not None and change > 0:
                builder.add_inhibition_arc(net.places[p].name, transition.name, capacity - change + 1)
    if clock:
        # Storm lets no time pass in a deadlock, and takes the long run of a single state for 0; a clock that ticks on
        # the side keeps every state of the net as it is, and gives it company.
        for name, tokens in (("tick", 1), ("tock", 0)):
            builder.add_place(None, tokens, name)
        for name, before, after in (("to_tock", "tick", "tock"), ("to_tick", "tock", "tick")):
            builder.add_timed_transition(0, 1.0, 1, name)
            builder.add_input_arc(before, name, 1)
            builder.add_output_arc(name, after, 1)
    jani, _ = gspn.build_jani_model(builder.build_gspn())
    return jani


class Storm:
    """Answers of Storm about one net. Long-run and first-passage values are exact (rational arithmetic)."""

    def __init__(self, net, clock=True):
        self._jani = storm_jani(net, clock)

    def _model(self, properties, exact):
        options = stormpy.BuilderOptions(properties, self._jani)
        options.set_apply_maximal_progress_assumption(True)  # without it time may pass in vanishing markings
        build = stormpy.build_model[stormpy.Rational] if exact else stormpy.build_model
        return build(self._jani, options=options)

    def state_count(self):
        """How many markings there are."""
        return self._model(self._parse("Pmin=? [F false]"), exact=False).nr_states

    def long_run(self, condition):
        """The long-run share of time in which a condition holds."""
        return self._exact("LRAmin=? [%s]" % condition)

    def probability(self, condition):
        """The probability that it ever holds."""
        return self._exact("Pmin=? [F %s]" % condition)

    def mean_time(self, condition):
        """The mean time until it holds; only where it surely does."""
        return self._exact("Tmin=? [F %s]" % condition)

    def within(self, condition, time):
        """The probability that it holds within a time."""
        return self._timed("Pmin=? [F<=%r %s]" % (time, condition), "MERGE_LABELS")

    def at(self, condition, time):
        """The probability that it holds at a time."""
        return self._timed("Pmin=? [F[%r,%r] %s]" % (time, time, condition), "DELETE_LABELS")

    def _parse(self, text):
        return list(stormpy.parse_properties(text, self._jani))

    def _exact(self, text):
        properties = self._parse(text)
        model = self._model(properties, exact=True)
        result = stormpy.model_checking(model, properties[0], environment=environments.exact())
        return float(result.get_value(model.initial_states[0]))

    def _timed(self, text, labels):
        properties = self._parse(text)
        model = self._model(properties, exact=False)
        formula = properties[0]
        if "MARKOV" in str(model.model_type).upper() or "MA" in str(model.model_type).upper():
            behaviour = getattr(transformations.EliminationLabelBehavior, labels)
            model, formulas = transformations.eliminate_non_markovian_chains(model, properties, behaviour)
            formula = formulas[0]
        result = stormpy.model_checking(model, formula)
        return float(result.get_value(model.initial_states[0])), str(model.model_type)
