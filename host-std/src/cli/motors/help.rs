//! Paragraphs that several subcommands have in their help.

/// What stops a motor that a subcommand moves, and what cannot.
pub(super) const STOPS: &str = "\
Whatever ends this program early stops the motor (0x81) first: an error, a fault of this program, a lost terminal, \
Ctrl-C, Ctrl-\\, Ctrl-Z, SIGTERM and any other signal that would end it and can be caught, except those of a fault \
(SIGSEGV and the like), even if nobody reads what is printed. A second Ctrl-C does not wait until the motor stands. If \
another program on the bus stops the motor or switches it off, this program ends, too.
Nothing stops the motor if this program is killed or frozen (kill -9, kill -STOP, a debugger, loss of power), or if the \
bus is cut. For that case set the motor's own communication-loss protection: 'myactuator timeout'.";

/// How a signal ends a program that it does not end at once.
pub(super) const SIGNALS: &str = "\
If a signal comes meanwhile, this program ends by that signal when it is done, even after a success. Ctrl-C, Ctrl-\\ \
and Ctrl-Z all end it as Ctrl-C does (status 130), and with it a shell's loop over motors. Other signals end it as \
themselves, such as SIGTERM (143) and SIGHUP (129). The loop of a script then goes on to the next motor unless it says \
'|| break'.";

/// What ends the holding of a motor.
pub(super) const HOLDS: &str = "\
A motor whose communication-loss protection (0xB3) is set, by 'myactuator timeout' or another program, does not hold for \
ever. Nothing talks to it after this program has ended, and when that time is up its output is off. Its shaft is free \
then unless it has a brake, which takes up to 200 ms to lock. Where a load could fall, lock the brake before that: \
'myactuator brake lock'.";

/// How long it takes to stop all motors, and which it cannot name.
pub(super) const OF_ALL: &str = "\
A stop of all takes about 1 s on CAN and 2 s on RS485 at 115200 bit/s (4 s if no motor answers). The motors get the \
command at its beginning; the rest is to listen, and to wait for ids that no motor has. A motor that never answers is \
not named: it looks like an id that no motor has.";

/// That a serial port is not shared.
pub(super) const SERIAL: &str = "\
A serial bus (slcan:, rs485:) can be opened by one program at a time. If another program moves the motors, end it.";

/// These paragraphs, with an empty line between them.
pub(super) fn paragraphs<const N: usize>(paragraphs: [&str; N]) -> String {
    paragraphs.join("\n\n")
}
