"""Clearances as BluebirdDT actions, BlueSky commands and CPDLC text.

All are made from the same `Instruction`; for words see `skystack.platforms.phraseology`.
"""

from skystack.platforms.instruction import Instruction

BluebirdAction = tuple[str, int | str | tuple[int, str]]
"""Kind and value of a BluebirdDT `Action`."""


def bluebird_actions(instruction: Instruction) -> list[BluebirdAction]:
    """BluebirdDT's actions: absolute values; the turn is the shorter way unless by direction."""
    actions: list[BluebirdAction] = []
    if instruction.heading_deg is not None:
        heading = instruction.heading_deg % 360
        if instruction.by_direction and instruction.turn is not None:
            actions.append(("change_heading_to_by_direction", (heading, instruction.turn)))
        else:
            actions.append(("change_heading_to", heading))
    if instruction.direct_to is not None:
        actions.append(("route_direct_to", instruction.direct_to))
    if instruction.level_fl is not None:
        actions.append(("change_flight_level_to", instruction.level_fl))
    return actions


def bluesky_commands(instruction: Instruction) -> list[str]:
    """Commands for BlueSky's command stack; BlueSky always turns the shorter way.

    `HDG` and `ALT` (the level as `FL340`) are its autopilot's selected heading and altitude. Fixes
    are not included: BlueSky gets them as positions, see `skystack.platforms.bluesky_scenario`.
    """
    commands = []
    if instruction.heading_deg is not None:
        commands.append(f"HDG {instruction.callsign} {instruction.heading_deg % 360:03d}")
    if instruction.level_fl is not None:
        commands.append(f"ALT {instruction.callsign} FL{instruction.level_fl:03d}")
    return commands


def cpdlc(instruction: Instruction) -> str:
    """One uplink message in the message elements of ICAO Doc 4444, Appendix 5.

    UM94 and UM190 for headings; UM74 for fixes; UM19, UM20 and UM23 for levels; " / " joins two
    elements. The addressee is not part of the text.
    """
    elements = []
    if instruction.heading_deg is not None:
        degrees = f"{instruction.heading_deg % 360 or 360:03d}"
        turn = f"TURN {instruction.turn.upper()}" if instruction.turn else "FLY"
        elements.append(f"{turn} HEADING {degrees}")
    if instruction.direct_to is not None:
        elements.append(f"PROCEED DIRECT TO {instruction.direct_to}")
    if instruction.level_fl is not None:
        verb = {"climb": "CLIMB TO", "descend": "DESCEND TO", None: "MAINTAIN"}
        elements.append(f"{verb[instruction.vertical]} FL{instruction.level_fl:03d}")
    return " / ".join(elements)
