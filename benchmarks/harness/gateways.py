"""Hosts behind gateways that translate addresses, as those of a mobile provider do: from a host one
gets out, and nothing gets in that was not asked for."""

from __future__ import annotations

from typing import Dict, List, Mapping, NamedTuple, Sequence, Tuple

TABLE = "gspn_nat"


class Gateways(NamedTuple):
    """Which hosts are behind which gateway; all names are different.

    >>> two = Gateways({"nat_a": ["one"], "nat_b": ["two", "three"]})
    >>> two.of("three"), two.of("nat_a"), two.addresses()["three"]
    ('nat_b', '', '10.78.2.3')
    """

    behind: Mapping[str, Sequence[str]]

    @property
    def hosts(self) -> Tuple[str, ...]:
        """All hosts."""
        return tuple(host for hosts in self.behind.values() for host in hosts)

    def of(self, host: str) -> str:
        """The gateway of a host; "" for what is not behind one."""
        return next((gateway for gateway, hosts in self.behind.items() if host in hosts), "")

    def addresses(self) -> Dict[str, str]:
        """The address of each host, which only those behind the same gateway can use."""
        return {
            host: self._subnet(gateway) + str(number)
            for gateway, hosts in self.behind.items()
            for number, host in enumerate(hosts, 2)
        }

    def _subnet(self, gateway: str) -> str:
        return "10.78.%d." % (1 + list(self.behind).index(gateway))

    def commands(self, gateway: str) -> List[List[str]]:
        """The words for ``ip`` that make a gateway's own network."""
        return [
            ["link", "add", "name", "lan", "type", "bridge"],
            ["addr", "add", self._subnet(gateway) + "1/24", "dev", "lan"],
            ["link", "set", "lan", "up"],
        ]

    def host_commands(self, host: str) -> List[List[str]]:
        """The words for ``ip`` that set up a host whose cable is there."""
        return [
            ["addr", "add", self.addresses()[host] + "/24", "dev", "eth0"],
            ["link", "set", "eth0", "up"],
            ["route", "add", "default", "via", self._subnet(self.of(host)) + "1"],
        ]

    @staticmethod
    def ruleset() -> str:
        """The input of ``nft -f -`` of a gateway."""
        return "\n".join(
            [
                "table ip %s {" % TABLE,
                "  chain translate {",
                "    type nat hook postrouting priority 100; policy accept;",
                '    oifname "eth0" masquerade',
                "  }",
                "  chain admit {",
                "    type filter hook forward priority 0; policy drop;",
                '    iifname "lan" accept',
                "    ct state established,related accept",
                "  }",
                "}",
                "",
            ]
        )
