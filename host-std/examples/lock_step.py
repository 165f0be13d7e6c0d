#!/usr/bin/env python3
"""A test of simulated drives under their own clock: exact, the same in every run, and faster than real time.

    myactuator sim --only slcan --link /tmp/robot --control /tmp/robot.sock --lock-step
    python3 lock_step.py /tmp/robot/slcan /tmp/robot.sock
"""

import json
import os
import socket
import struct
import sys
import tty

READ_ANGLE, MOVE_TO = 0x92, 0xA4


def main(terminal, control):
    bus = os.open(terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(bus)
    simulation = socket.socket(socket.AF_UNIX)
    simulation.connect(control)
    lines = simulation.makefile("rw", encoding="utf-8", newline="\n")

    def request(name, **takes):
        """Asks the simulation something; gives its answer."""
        lines.write(json.dumps({name: takes}) + "\n")
        lines.flush()
        answer = json.loads(lines.readline())
        assert "ok" in answer, answer
        return answer["ok"]

    def received():
        """What has come by now: until nothing is left, for one read need not give all of it."""
        come = b""
        while True:
            try:
                come += os.read(bus, 4096)
            except BlockingIOError:
                return come

    def send(motor, data):
        os.write(bus, b"t%03X8%s\r" % (0x140 + motor, data.hex().upper().encode()))

    os.write(bus, b"C\rS8\rO\r")
    # To 90 degrees, in steps of 0.01, at up to 180 degrees a second.
    send(1, struct.pack("<BxHi", MOVE_TO, 180, 9000))
    for _ in range(10):
        request("advance", us=100_000)
        received()
        send(1, bytes([READ_ANGLE, 0, 0, 0, 0, 0, 0, 0]))
        at_us = request("advance", us=2_000)["at_us"]
        reply = received().split(b"t2418")[-1].rstrip(b"\r")
        (told,) = struct.unpack_from("<i", bytes.fromhex(reply.decode()), 4)
        (motor,) = request("state", motor=1)["buses"][0]["motors"]
        print(f"{at_us / 1e6:.3f} s: motor 1 tells {told / 100:.2f} deg and is at {motor['angle_deg']:.6f} deg")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
