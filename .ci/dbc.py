"""Compares what cantools decodes by the file of `myactuator dbc` with what the manual's examples mean
and with what `myactuator decode` makes of them. Takes the program and the examples."""

import json
import math
import subprocess
import sys

import cantools
from cantools.database.can import Message
from cantools.database.namedsignalvalue import NamedSignalValue

# How many of the manual's examples are CAN frames: see tests/vectors/README.md.
ROWS = 101
EITHER_WAY = 0x300


def run(program, *arguments, text=None):
    return subprocess.run(
        [program, *arguments], input=text, check=True, stdout=subprocess.PIPE, encoding="ascii"
    ).stdout


def load(program, *arguments):
    file = run(program, "dbc", *arguments)
    return cantools.database.load_string(file, "dbc", strict=True)


class Frame:
    """A frame as cantools decodes it."""

    def __init__(self, message: Message, data: bytes):
        self.message = message
        self.named = message.decode(data)
        self.scaled = message.decode(data, decode_choices=False)
        self.raw = message.decode(data, decode_choices=False, scaling=False)

    def signals(self, name, key):
        """The signals of a field, by the rule of names: several for a text, else one."""
        # What may be between command and field: the value that selects it.
        words = ["", "other_"]
        words += [f"{value}_" for value in self.named.values() if isinstance(value, NamedSignalValue)]
        for word in words:
            signal = f"{name}_{word}{key}".replace("-", "_").replace(".", "_")
            characters = [f"{signal}_{place}" for place in range(1, 8)]
            for candidates in ([signal], characters):
                if all(candidate in self.named for candidate in candidates):
                    return candidates
        raise LookupError(f"no signal for {key} of {name} among {', '.join(self.named)}")

    def agrees(self, signals, value):
        """Whether the signals say this value, as JSON has it."""
        if len(signals) > 1:
            characters = bytes(self.raw[signal] for signal in signals)
            return characters.rstrip(b"\0").decode("ascii") == value
        [signal] = signals
        named, scaled, raw = self.named[signal], self.scaled[signal], self.raw[signal]
        match value:
            case None:
                return not isinstance(named, NamedSignalValue)
            case bool():
                return raw == int(value) and str(named) == ("on" if value else "off")
            case str():
                return str(named) == value
            case list():
                flags = self.message.get_signal_by_name(signal).choices
                return [str(flags[bit]) for bit in sorted(flags) if raw & bit] == value
            case _:
                # A float of the frame has 24 bits; its decimal has the fewest digits that distinguish it.
                is_float = self.message.get_signal_by_name(signal).is_float
                return math.isclose(scaled, value, rel_tol=1e-7 if is_float else 1e-9, abs_tol=1e-12)


def differences(frame, explanation, example):
    """Sentences about what is not as it should be."""
    name, told = explanation["name"], explanation["fields"]
    if name != example["name"]:
        yield f"decode calls it {name}"
    if explanation["opcode"] is not None:
        byte = frame.named["command_byte"]
        if (str(byte), f"0x{byte.value:02X}") != (name, explanation["opcode"]):
            yield f"its command byte is {byte!r}"
    for key in example["fields"].keys() - told.keys():
        yield f"decode has no {key}"

    signals = []
    compared = {"command_byte"}
    for key, value in told.items():
        values = [value] + ([example["fields"][key]] if key in example["fields"] else [])
        if key.endswith("_raw"):
            # The number of the text before it.
            [signal] = signals
            agrees = all(frame.raw[signal] == value for value in values)
        else:
            signals = frame.signals(name, key)
            agrees = all(frame.agrees(signals, value) for value in values)
        compared.update(signals)
        if not agrees:
            found = ", ".join(f"{signal} {frame.scaled[signal]}" for signal in signals)
            yield f"{key} should be {' and '.join(map(str, values))}, but is {found}"
    if frame.message.frame_id != EITHER_WAY:
        for signal in frame.named.keys() - compared:
            yield f"{signal} is no field of it"


def main(program, vectors):
    with open(vectors, encoding="utf-8") as lines:
        examples = [example for example in map(json.loads, lines) if example["bus"] == "can"]
    database = load(program)
    rows = wrong = 0
    for direction in ("command", "reply"):
        group = [example for example in examples if example["direction"] == direction]
        text = "".join(example["frame"] + "\n" for example in group)
        told = run(program, "decode", "--json", "--direction", direction, text=text).splitlines()
        for example, line in zip(group, told, strict=True):
            identifier, data = example["frame"].split("#")
            rows += 1
            try:
                message = database.get_message_by_frame_id(int(identifier, 16))
                frame = Frame(message, bytes.fromhex(data))
                found = list(differences(frame, json.loads(line), example))
            except (LookupError, cantools.database.DecodeError) as error:
                found = [str(error)]
            for sentence in found:
                wrong += 1
                print(f"{example['frame']} ({direction}, {example['section']}): {sentence}")
    print(f"{rows} rows, {len(database.messages)} messages")

    one = {message.frame_id for message in load(program, "--id", "3").messages}
    if one != {0x143, 0x243, 0x403, 0x503, 0x280, 0x300}:
        sys.exit(f"error: --id 3 gives the identifiers {sorted(map(hex, one))}")
    load(program, "--firmware", "v4.4")
    if wrong:
        sys.exit(f"error: {wrong} differences")
    if rows != ROWS:
        sys.exit(f"error: expected {ROWS} rows")


main(*sys.argv[1:])
