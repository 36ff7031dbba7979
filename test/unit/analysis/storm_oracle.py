"""The model checker Storm as an independent oracle: the same net through its own GSPN translation
and checkers."""

import stormpy
from stormpy import developer, environments, transformations

from benchmarks.storm import storm_jani

# Storm's time-bounded answers are good to 1e-6 by default, which is what the tests ask of ours.
# stormpy.Environment does not show that part of Storm's environment, so it is set as by Storm's
# command line, for the whole process.
developer.set_from_exploded_string(["--timebounded:precision", "1e-9"])


class Storm:
    """Answers of Storm about one net. Long-run and first-passage values are exact (rational
    arithmetic)."""

    def __init__(self, net, clock=True):
        self._jani = storm_jani(net, clock=clock)

    def _model(self, properties, exact):
        options = stormpy.BuilderOptions(properties, self._jani)
        # without it time may pass in vanishing markings
        options.set_apply_maximal_progress_assumption(True)
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

    def until(self, stay, goal, time=None):
        """The probability that one condition holds until another does, within a time or ever."""
        if time is None:
            return self._exact("Pmin=? [%s U %s]" % (stay, goal)), "exact"
        return self._timed("Pmin=? [%s U<=%r %s]" % (stay, time, goal), "MERGE_LABELS")

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
            model, formulas = transformations.eliminate_non_markovian_chains(
                model, properties, behaviour
            )
            formula = formulas[0]
        result = stormpy.model_checking(model, formula)
        return float(result.get_value(model.initial_states[0])), str(model.model_type)
