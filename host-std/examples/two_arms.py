"""Moves the left arm of two_arms.toml by python-can over SLCAN, and notes all frames as `candump -L` does.

    myactuator sim host-std/examples/two_arms.toml --link /tmp/robot
    python3 host-std/examples/two_arms.py   # needs python-can and pyserial
    myactuator decode left.log
"""

import struct
import time

import can

READ_ANGLE, MOVE_TO, STOP = 0x92, 0xA4, 0x81

with (
    can.Bus(interface="slcan", channel="/tmp/robot/left", bitrate=1_000_000) as bus,
    can.CanutilsLogWriter("left.log", channel="left") as log,
):

    def ask(motor, data):
        """Sends a command to a motor, and gives what it answers."""
        command = can.Message(
            timestamp=time.time(), arbitration_id=0x140 + motor, data=data, is_extended_id=False
        )
        bus.send(command)
        reply = bus.recv(timeout=1.0)
        assert reply and reply.arbitration_id == 0x240 + motor, f"no reply of motor {motor}"
        log(command)
        log(reply)
        return reply.data

    try:
        for motor in (1, 2, 3):
            # To 45 degrees, in steps of 0.01, at up to 90 degrees a second. Here this opens the brake.
            ask(motor, struct.pack("<BxHi", MOVE_TO, 90, 4500))
        time.sleep(2)
        for motor in (1, 2, 3):
            (angle,) = struct.unpack_from("<i", ask(motor, bytes([READ_ANGLE] + 7 * [0])), 4)
            print(f"motor {motor} is at {angle / 100:.2f} deg")
    except BaseException:
        for motor in (1, 2, 3):
            bus.send(
                can.Message(arbitration_id=0x140 + motor, data=[STOP] + 7 * [0], is_extended_id=False)
            )
        raise
