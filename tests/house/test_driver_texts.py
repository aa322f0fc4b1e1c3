"""The texts of a driver that a user reads in help, status and pages are plain."""

from __future__ import annotations

import re

import pytest

from tests.agents.test_one_vocabulary import DRIVERS

PERSONIFIED = re.compile(r"\b(told|tells?|says|not say|said|hears?|nobody|whoever|whose|whom)\b", re.IGNORECASE)
"""Words that make a program or a robot speak."""


@pytest.mark.parametrize("robot", DRIVERS)
def test_options_and_services_are_described_in_plain_words(robot: str) -> None:
    driver = DRIVERS[robot]
    texts = [
        *driver.OPTIONS.values(),
        *(service.about for service in driver.SERVICES.values()),
        *(verb.description for verb in driver.TOOL_VERBS),
        driver.firmware_watchdog,
    ]
    assert [text for text in texts if PERSONIFIED.search(text)] == []


@pytest.mark.parametrize("robot", DRIVERS)
def test_the_firmware_s_reaction_is_a_sentence(robot: str) -> None:
    text = DRIVERS[robot].firmware_watchdog
    assert len(text.split()) >= 5 and not text.lower().startswith(("none", "no ")), text
