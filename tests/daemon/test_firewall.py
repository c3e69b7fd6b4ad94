"""Claims about reading packet filter rules. Truth: rule sets as the tools print them, and what they are known to do."""

from __future__ import annotations

import pytest

from daemon.doctor.firewall import accepts_port, check_packet_filter, judge_rules

NFT_OPEN = """table ip nat {
	chain POSTROUTING {
		type nat hook postrouting priority srcnat; policy accept;
		oifname "eth0" masquerade
	}
}
"""
NFT_CLOSED = """table inet filter {
	chain input {
		type filter hook input priority filter; policy drop;
		ct state established,related accept
		iif "lo" accept
		tcp dport 22 accept
		udp dport { 5353, 30200-30209 } accept
	}
	chain forward {
		type filter hook forward priority filter; policy drop;
	}
}
"""
NFT_FORWARD_ONLY = """table inet filter {
	chain forward { type filter hook forward priority filter; policy drop; }
}
"""
UFW = """*filter
:INPUT DROP [0:0]
:FORWARD DROP [0:0]
:OUTPUT ACCEPT [0:0]
-A INPUT -j ufw-user-input
-A ufw-user-input -p tcp -m tcp --dport 22 -j ACCEPT
-A ufw-user-input -s 192.170.10.2/32 -p udp -m udp --dport 30200 -j ACCEPT
COMMIT
"""


@pytest.mark.parametrize(
    ("rules", "port", "judgement"),
    [
        ("", 30200, "nothing dropped"),
        (NFT_OPEN, 30200, "nothing dropped"),
        (NFT_FORWARD_ONLY, 30200, "nothing dropped"),
        (NFT_CLOSED, 30200, "accepted"),
        (NFT_CLOSED, 30209, "accepted"),
        (NFT_CLOSED, 30210, "may drop"),
        (NFT_CLOSED, 22, "may drop"),
        (UFW, 30200, "accepted"),
        (UFW, 30201, "may drop"),
        (UFW, 22, "may drop"),
        ("# a comment that says drop\n", 30200, "nothing dropped"),
    ],
)
def test_rules_are_judged_as_they_act_on_datagrams(rules: str, port: int, judgement: str) -> None:
    assert judge_rules(rules, port) == judgement


@pytest.mark.parametrize(
    ("rule", "accepted"),
    [
        ("-A INPUT -p udp -m multiport --dports 100,30200 -j ACCEPT", True),
        ("-A INPUT -p udp -m udp --dport 30000:30300 -j ACCEPT", True),
        ("-A INPUT -p udp -m udp --dport 30200 -j DROP", False),
        ("-A INPUT -p udp -m udp --sport 30200 -j ACCEPT", False),
        ("ip saddr 192.170.10.2 udp dport 30200 accept", True),
        ("udp dport ssh accept", False),
        ("tcp dport 30200 accept", False),
    ],
)
def test_a_rule_accepts_a_port_alone_in_a_set_or_in_a_range(rule: str, accepted: bool) -> None:
    assert accepts_port(rule, 30200) is accepted


def test_messages_that_arrive_settle_the_question() -> None:
    check = check_packet_filter(30200, heard=True)
    assert (check.status, check.remedy) == ("ok", "")
