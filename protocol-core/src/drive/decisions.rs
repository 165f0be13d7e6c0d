//! What a [`Drive`](super::Drive) does where the manual is silent or contradicts itself.
//!
//! Each decision stands here once, with the section of the manual that leaves it open. What real
//! drives were seen to do otherwise is in [`Quirks`](super::Quirks), all off by default.
//!
//! # Packets
//! - What cannot be read, an unknown command, a value out of range, and an index or a code that the manual does not
//!   name have no effect and no answer. Watchers see [`Event::Ignored`](super::Event::Ignored).
//! - The id filter keeps commands to 0x280 out, as 2.35.4 says, and nothing else: bus ids at 0x300
//!   pass. RS485 has no identifiers to filter by, so that 0xCD always reaches a drive there.
//! - Replies leave in the order of their commands, each after the drive's response delay: the first in the queue delays
//!   those after it, as a drive does one thing after the other.
//! - Nothing keeps the answers of several drives to 0xCD apart, so on RS485 they collide: by 6.2 they come "at the same
//!   time". But 6.2 also shows all four answers, whole; that is [an option](super::Quirks::broadcast_slots).
//!
//! # What is kept, and when it acts
//! A drive holds its [`Settings`](super::Settings) twice: as they are stored, and as they act.
//!
//! | changes | |
//! |---|---|
//! | what acts | 0x31 |
//! | what is stored, which acts after a restart | 0x63, 0x64, 0x79, 0xB4, functions 1, 4 and 5 |
//! | both | 0x32, 0x43, 0xB3, functions 2, 6 and 7 |
//!
//! - Function 3 and 0xB6 end with a restart: nothing says that they are saved (2.34, 2.35.4).
//! - Writing to ROM while the motor moves works: the manual advises against it, but forbids nothing
//!   (2.3.1, 2.5.1, 2.9.1, 2.10.1, 2.31.1, 2.35.1).
//! - A memory that fails raises the error of calibration parameters (0x0080, 2.14.3), and the
//!   command that wanted to write has no answer.
//!
//! # Start, restart and supply
//! - A restart (0x76, 2.26) drops what is only in RAM: gains of 0x31, active replies, error
//!   reporting, the mode, the turns unless they are saved, errors of level one, and a loss of
//!   communication. The output is off and the brake locked.
//! - Replies to commands that came before 0x76 still go out. Those that wait when the supply goes
//!   do not.
//! - A drive hears nothing while it starts.
//! - Below [a voltage](super::Parameters::brown_out_voltage_v) that the manual does not mention, a drive is off, as
//!   without its supply. It starts when the voltage is back.
//! - The run time (0xB1) counts from the beginning of the start. It is a u32 (2.29.3), which begins anew at 0 after
//!   2^32 ms, 49.7 days.
//! - Without its supply, and while it starts, the motor turns freely unless it has a brake.
//!
//! # Motor id
//! - A new id (0x79, function 5) acts after a restart, as 2.35.4 says of function 5; 4 and 7 say
//!   nothing. Until then 0x79 reads the id that acts. CAN and RS485 share one id.
//! - A reply to 0x79 looks like its command, and every drive hears it (4, 7). So that two drives do
//!   not answer each other for ever, a read that already holds an id, and a write of the id that
//!   was taken less than 20 ms ago, count as another drive's reply.
//! - On CAN the reply to a read holds the reply identifier (4.4), on RS485 the bare id in the last
//!   byte, as in the example of 7.4 and against the table of 7.3.
//!
//! # Turns and zero
//! Three numbers give every reading of place:
//!
//! - the *pulses* of the motor shaft, as the plant measures them;
//! - the *raw* position: the pulses less some whole turns, chosen at the start, of the output shaft or, with only the
//!   encoder on the motor shaft, of the motor shaft;
//! - the position: the raw position less the zero offset (2.6.3).
//!
//! Decisions about them:
//!
//! - At a start without saved turns the angle is within half a turn of the zero: -180° to less than
//!   180°. With one encoder it is within half a turn of the motor shaft, as such drives report.
//! - With saved turns (function 4) the raw position is the closest to the saved one that the shaft's place allows. That
//!   is right as long as the shaft was turned by less than half a turn while the drive was off. Turns are saved at a
//!   restart and at power-off. The first start after function 4 was switched on has none to restore.
//! - Function 1 makes the shaft's place within its turn the new zero. Earlier turns are lost at the restart; later ones
//!   count, if turns are saved (2.35.4).
//! - 0x62 reads the zero offset that acts: a new one is valid only after a restart (2.9.1, 2.10.1).
//! - Readings end where their fields do: 0x60 to 0x62 and 0x92 at the ends of 32 bits, feedback at
//!   ±32767° (2.15.3).
//! - 0x90 counts within a turn of the motor shaft, 0x94 within one of the output shaft. Of an encoder
//!   with more than 16 bits 0x90 and the reply to 0xA6 hold the upper 16 (2.11.3, 2.22.3).
//! - Clockwise is the direction in which angles grow (2.13.3), for 0xA6 too.
//!
//! # Motion
//! - 0x81 slows the motor down by the deceleration of speed planning. Then it holds the place where the motor has come
//!   to rest, in the position loop (2.18.1). A motor that already rests at its target goes on holding that. Behind a
//!   locked brake 0x81 does nothing: the brake holds.
//! - 0xA2 takes a torque limit of 0 as no limit (2.20.1). In 0xA9 a limit of 0 allows no torque, for 2.24.1 does not
//!   call it "no limit". The stall current limits every command, 0xA1 and motion mode included.
//! - The targets of 0xA4, 0xA6, 0xA8 and 0xA9 are clamped to the angles of functions 6 and 7: the motor goes as far as
//!   it may. Speed, torque and motion mode are not "position running" and have no such limits.
//! - A limit of function 6 or 7 acts "at once" (2.35.4), where other functions act after a restart. So it also ends the
//!   motion under way. It begins none: a shaft that is already beyond it is held where it is, for setting a limit is no
//!   request to move.
//! - For functions 6 and 7 the manual gives no unit and no sign. 0.01° and a signed number are assumed, as in every
//!   commanded angle. It names no value for no limit: 0 is an angle like any other, and an angle that is out of reach
//!   lifts the limit.
//! - 0xA8 counts from where the shaft is, not from where it was to go (2.23.1).
//! - 0xA6 runs only in single-turn mode, with function 4 off (2.22.1); otherwise it is answered and does nothing.
//!   Within half a degree of its target it goes the short way, whatever the direction says: a command sent twice must
//!   not add a turn.
//! - A maximum speed of 0 in planning is [the motor's own](super::Parameters::max_speed_dps); in
//!   direct tracking it is no limit (2.21.1).
//! - A deceleration of 0 in position planning stands for the acceleration's value. In speed planning 0 is no ramp:
//!   2.20.2 says so of the acceleration, and it is taken to hold for the deceleration.
//! - A reversal of the speed uses the acceleration from end to end: by 2.4.4 the deceleration acts "in the same
//!   direction" only, and the acceleration "in both". A change to speed 0, which has no direction, uses the
//!   deceleration. In position planning the deceleration is the way "to standstill", so a motor that has to turn back
//!   uses it first and then the acceleration.
//! - A position command that follows another goes on from the planned place and speed. If the shaft was held back by
//!   10° or more, or stands while its plan waits for it, the command goes on from where the shaft is.
//! - Motion mode divides the torque by the motor's torque constant, where 5.1 prints a multiplication. Feedback beyond
//!   a scale is the scale's end.
//! - 0x70 knows three modes (2.25.3). Motion mode sets a current, so it is the current loop. A motor that stops is in
//!   the speed loop, one that holds in the position loop. If no loop runs the byte is 0: 0x80 "clears the running
//!   state" and leaves "no closed-loop mode" (2.17.1), and any of the three modes would report a motor that is off as
//!   running.
//!
//! # Gains
//! The manual names seven gains and does not say what they do (2.1.4). Here there are three nested loops, in the units
//! of [`Gains`](super::Gains). They run at [10 kHz](super::Parameters::control_period):
//!
//! - position: speed = the profile's speed + kp·e + ki·∫e + kd·de/dt;
//! - speed: current = kp·e + ki·∫e. If the position loop has the shaft within 0.01°, the unit of every commanded angle,
//!   the integral does not grow: otherwise static friction would make it break the shaft away for ever;
//! - current: what is missing comes at a rate of 10000·kp + ki a second, with kp 1 at once. The manual's own example of
//!   a gain is a current KP of 1.5 (2.2.5), so no gain of this loop changes how much current flows in the end.
//!
//! A drive does not know its load. [Factory gains](super::Gains::tuned) keep the position loop and the integral so far
//! below the speed loop that the loops are stable up to 240 times the motor's own inertia. Nor does it know how hard it
//! can brake. A plan that asks for more than the current gives waits for the shaft; a shaft that is then too fast to
//! brake overshoots its target and comes back. Accelerations that suit the load (0x43) avoid that.
//!
//! No gain that a master can write makes a drive put out more than the stall current.
//!
//! # Brake
//! - A drive starts with its brake locked, the state that it has without power (2.28.1).
//! - Speed and position commands need no 0x77: they open the brake themselves. The torque command must not (2.19.1),
//!   and neither must motion mode, which is a torque command in all but name. Behind a locked brake these two are
//!   answered and do nothing.
//! - The reply to 0x77 does not wait until the brake is open.
//! - 0x78 ends what runs and switches the output off, once the brake holds: "the motor cannot run then" (2.28.1).
//! - 0x80 locks a brake that a command opened on its own, so that a load does not go on falling. A brake that 0x77
//!   opened stays open, so that a person can turn the shaft by hand. Errors and the loss of communication lock either.
//! - A motor without a brake answers 0x77 and 0x78, which do nothing else. 0x9A then reports the brake as released:
//!   nothing holds the shaft (2.14.3).
//!
//! # Errors
//! | error | comes when | goes |
//! |---|---|---|
//! | stall | the current is at the stall current and the speed low, for the stall time | with 0x76 |
//! | under- and over-voltage | the supply is beyond its limit | when it is back |
//! | over-current | a phase current is beyond its limit | with 0x76 |
//! | over-power | the supply current is beyond its limit | when it is back |
//! | calibration parameters | the memory fails | with 0x76 |
//! | over-speed | the speed is beyond its limit | when it is back |
//! | over-temperatures | the motor or the output stage is too hot | when it has cooled down |
//! | encoder calibration | never on its own | when it is taken away |
//! | encoder data | the encoder's data cannot be trusted | with 0x76 |
//!
//! - The limits are [`FaultLimits`](super::FaultLimits); the manual gives no numbers (8.2). Any
//!   error can also be [raised by hand](super::Drive::raise_fault).
//! - The manual gives two errors no level (8.2). The over-temperature of components recovers like that of the motor, as
//!   heat goes on its own. Wrong encoder data needs 0x76, as a position that was once wrong stays doubtful; so do
//!   errors that the manual does not name.
//! - Hardware over-current has no bit (2.14.3), so it never comes.
//! - **Any** error cuts the output, leaves every mode and locks the brake. While it stands, commands that move the
//!   motor (0xA1 to 0xA9, motion mode) and 0x81 are answered as usual and change nothing. Sections 2.19.1 and later say
//!   that control commands run without a fault; for 0x81, 0xA6 and motion mode it is decided here. Everything else
//!   works, 0x77 included.
//! - When the last error has gone, the drive is ready again ("recovers normal operation by itself", 8.1) but stands
//!   still until the next command: a motor that resumes an old command on its own may hurt someone.
//! - The light (8.1) blinks fast if any error needs 0x76, else slowly if there is one.
//!
//! # Loss of communication
//! "If communication is interrupted for longer than the set time, the output is cut and the brake
//! locked. To run again, steady communication must be established first" (2.31.1).
//!
//! - Every command for this drive that it understands is communication, including reads and commands to all.
//! - The watch begins with the first command after a start: what has not begun cannot be interrupted.
//! - Communication is steady when three commands have come, each within the set time of the one before; the last of
//!   them already runs. Until then commands that move the motor, 0x81 and 0x77 are answered and do nothing. All others
//!   work.
//! - Switching the protection off (time 0) ends the loss.
//!
//! # What is sent unasked
//! - Active replies (0xB6) have one interval, the last one set. Every interval one reply goes out;
//!   with several commands enabled they take turns ("in a cycle, alternately, at the set time",
//!   2.34.1), in the order in which they were first enabled. An interval of 0 counts as one step of
//!   10 ms.
//! - "The motor no longer replies when it receives a command" (2.34.1): a poll of what is reported actively stays
//!   unanswered. All other commands are answered as usual, unless [an option](super::Quirks::silent_while_reporting)
//!   takes the sentence literally.
//! - The first error report (function 3) goes out as soon as there is an error, or reporting is switched on.
//!   Measurements are compared with their limits every millisecond.
//!
//! # Bit rate
//! - 0xB4 acts at the next start, by 0x76 or power-on, and its reply still has the old rate. The manual says both that
//!   it acts "when powered on again" (2.32.1) and that the reply is of no use because the rate has changed (2.32.3). A
//!   master that believes the second waits for no reply, and is right either way.
//! - The reply's bytes after the command byte mean nothing (2.32.3).
//! - A code without a meaning on the drive's bus, such as 2 on CAN (2.32.4), changes nothing and
//!   has no answer.
