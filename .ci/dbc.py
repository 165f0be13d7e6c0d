"""Decodes the manual's examples in cantools, with the file of `myactuator dbc`. Compares the result with
the examples' meaning and with the output of `myactuator decode`. Arguments: the program and the examples."""

import json
import math
import subprocess
import sys

import cantools
from cantools.database.can import Message
from cantools.database.namedsignalvalue import NamedSignalValue

# The number of the manual's examples that are CAN frames: see tests/vectors/README.md.
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
        """The signals of a field, found by their names: one for each character of a text, otherwise one."""
        # Between command and field, the name may have the value that selects the field.
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
        """Whether the signals have this value, which comes from JSON."""
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
                # A float in a frame has 24 bits. Its decimal has the fewest digits that identify it.
                is_float = self.message.get_signal_by_name(signal).is_float
                return math.isclose(scaled, value, rel_tol=1e-7 if is_float else 1e-9, abs_tol=1e-12)


def differences(frame, explanation, example):
    """Yields a sentence for each difference."""
    name, explained = explanation["name"], explanation["fields"]
    if name != example["name"]:
        yield f"expected the name {example['name']}, decode has {name}"
    if explanation["opcode"] is not None:
        byte = frame.named["command_byte"]
        if (str(byte), f"0x{byte.value:02X}") != (name, explanation["opcode"]):
            yield f"expected the command byte {name} {explanation['opcode']}, cantools has {byte!r}"
    for key in example["fields"].keys() - explained.keys():
        yield f"expected a field {key}, decode has none"

    signals = []
    compared = {"command_byte"}
    for key, value in explained.items():
        values = [value] + ([example["fields"][key]] if key in example["fields"] else [])
        if key.endswith("_raw"):
            # The number that belongs to the text before it.
            [signal] = signals
            agrees = all(frame.raw[signal] == value for value in values)
        else:
            signals = frame.signals(name, key)
            agrees = all(frame.agrees(signals, value) for value in values)
        compared.update(signals)
        if not agrees:
            found = ", ".join(f"{signal} {frame.scaled[signal]}" for signal in signals)
            yield f"expected {key} {' and '.join(map(str, values))}, found {found}"
    if frame.message.frame_id != EITHER_WAY:
        for signal in frame.named.keys() - compared:
            yield f"decode has no field for the signal {signal}"


def main(program, vectors):
    with open(vectors, encoding="utf-8") as lines:
        examples = [example for example in map(json.loads, lines) if example["bus"] == "can"]
    database = load(program)
    rows = wrong = 0
    for direction in ("command", "reply"):
        group = [example for example in examples if example["direction"] == direction]
        text = "".join(example["frame"] + "\n" for example in group)
        explanations = run(program, "decode", "--json", "--direction", direction, text=text).splitlines()
        for example, line in zip(group, explanations, strict=True):
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
        sys.exit(f"error: unexpected identifiers with --id 3: {sorted(map(hex, one))}")
    load(program, "--firmware", "v4.4")
    if wrong:
        sys.exit(f"error: {wrong} differences")
    if rows != ROWS:
        sys.exit(f"error: expected {ROWS} rows, found {rows}")


main(*sys.argv[1:])
