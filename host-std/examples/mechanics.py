#!/usr/bin/env python3
"""Mechanics for simulated motors in a process of their own: pendulums that a spring joins to their neighbours.

    python3 mechanics.py SOCKET

Listens on the Unix socket SOCKET for one simulation, which sends a line of JSON a period and waits for one:

    to it    {"period_us":500,"shafts":[{"motor":1,"torque_nm":1.5,"friction_nm":0.2,"angle_deg":0.0,"speed_dps":0.0}]}
    from it  {"shafts":[{"angle_deg":0.0,"speed_dps":0.9}]}

torque_nm is what motor and hand put on the shaft, friction_nm what friction and brake take from it at most. The
motor's own inertia is to be minded here. Put a step of your own engine in the place of `step`.
"""

import json
import math
import os
import socket
import sys

INERTIA = 0.12 + 0.06  # kg·m²: 1.33 kg at 0.3 m, and an X8-120's rotor through its gear
WEIGHT = 1.33 * 9.80665 * 0.3  # N·m, held out level
SPRING = 5.0  # N·m/rad between neighbours


def step(seconds, shafts):
    """Moves the shafts on; gives their angles and speeds."""
    angles = [math.radians(shaft["angle_deg"]) for shaft in shafts]
    moved = []
    for place, shaft in enumerate(shafts):
        speed = math.radians(shaft["speed_dps"])
        angle = angles[place]
        torque = shaft["torque_nm"] - WEIGHT * math.sin(angle)
        for neighbour in (place - 1, place + 1):
            if 0 <= neighbour < len(shafts):
                torque += SPRING * (angles[neighbour] - angle)
        freely = speed + torque / INERTIA * seconds
        taken = shaft["friction_nm"] / INERTIA * seconds
        speed = math.copysign(max(abs(freely) - taken, 0.0), freely)
        moved.append({"angle_deg": math.degrees(angle + speed * seconds), "speed_dps": math.degrees(speed)})
    return moved


def main():
    path = sys.argv[1]
    if os.path.exists(path):
        os.unlink(path)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen(1)
        connection, _ = listener.accept()
    os.unlink(path)
    with connection, connection.makefile("rw", encoding="utf-8", newline="\n") as lines:
        for line in lines:
            asked = json.loads(line)
            shafts = step(asked["period_us"] * 1e-6, asked["shafts"])
            lines.write(json.dumps({"shafts": shafts}) + "\n")
            lines.flush()


if __name__ == "__main__":
    main()
