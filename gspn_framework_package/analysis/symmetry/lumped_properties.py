"""Qualitative properties of a net with exchangeable parts, from one marking of each orbit."""

from __future__ import annotations

from functools import cached_property
from typing import Dict

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices
from gspn_framework_package.analysis.graph import can_reach
from gspn_framework_package.analysis.state_space.properties import Liveness, Properties
from gspn_framework_package.analysis.symmetry.lumped_space import LumpedSpace
from gspn_framework_package.model.errors import LimitError


class LumpedProperties(Properties):
    """Properties of the whole net, derived from the space of orbits.

    A cycle of orbits unrolls to a cycle of markings, since a permutation repeated often enough is
    the identity. So bounds, L0, L1 and L3 (by orbits of transitions), deadlocks and reversibility
    follow at once. But one final component of orbits may represent several components of markings
    that an exchange maps to each other, such as "robot 1 keeps the tool forever" and "robot 2
    does". It represents one if one of its markings is its whole orbit. Otherwise, home states and
    the liveness of exchangeable transitions are not decided.

    :param space: a complete lumped space.
    """

    space: LumpedSpace

    @cached_property
    def bounds(self) -> Dict[str, int]:
        """See :attr:`Properties.bounds`."""
        names = [place.name for place in self.space.net.places]
        most = np.zeros(len(names), dtype=np.int64)
        of = self.space.symmetry.place_orbits
        np.maximum.at(most, of, np.array(self.space.store.largest(), dtype=np.int64))
        return dict(zip(names, most[of].tolist()))

    @property
    def reversible(self) -> bool:
        """See :attr:`Properties.reversible`. The initial marking is its whole orbit."""
        space = self.space
        return bool(can_reach(len(space), space.sources, space.targets, space.starts).all())

    @cached_property
    def alone(self) -> Booleans:
        """Boolean array over the components: the final ones that represent a single component of
        markings."""
        found = self.components
        alone = np.zeros(found.number, dtype=bool)
        alone[found.of[np.flatnonzero(self.space.sizes == 1)]] = True
        return alone & found.bottom

    @property
    def home_states(self) -> Indices:
        """See :attr:`Properties.home_states`.

        :raises LimitError: not decided; see the class.
        """
        states = super().home_states
        if not len(states) or self.alone.any():
            return states
        if len(states) == 1 and len(self.space.deadlocks):
            return states[:0]  # several deadlocks that an exchange maps to each other
        raise _several()

    @cached_property
    def liveness(self) -> Dict[str, Liveness]:
        """See :attr:`Properties.liveness`.

        :raises LimitError: not decided; see the class.
        """
        of = self.space.symmetry.transition_orbits
        size = np.bincount(of)
        level, orbit, component = self._levels(of)
        sure = np.bincount(orbit, self.alone[component], minlength=len(size))
        if ((level == Liveness.L4) & (sure < self.components.bottom.sum()) & (size > 1)).any():
            raise _several()
        names = [t.name for t in self.space.net.transitions]
        return {name: Liveness(v) for name, v in zip(names, level[of].tolist())}


def _several() -> LimitError:
    return LimitError(
        "not decided: a final component of orbits may represent several components of markings",
        hint="analyse the whole net (without --lump)",
    )
