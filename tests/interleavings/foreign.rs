//! Other masters on the same bus, as this master hears them. On a line it also hears their commands, which look like
//! answers.

use myactuator_protocol_core::master::StopKind;
use myactuator_protocol_core::{Channel, Data, Packet, Target};

use super::search::Broken;
use super::state::State;
use super::world::{Medium, motor_at};

/// A command that this master never sends.
const READ: Data = [0x60, 0, 0, 0, 0, 0, 0, 0];
const VALUES: Data = [0x60, 1, 0, 0, 0xEE, 0, 0, 0];
/// A command that it sends, but not to that motor.
const OF_THEIRS: Data = [0x92, 1, 0, 0, 0xEE, 0, 0, 0];

impl<const N: usize> State<N> {
    /// Another master asks one of our motors and one of its own, and both answer. On a line it waits until the line is
    /// free.
    pub(super) fn foreign(&mut self) -> Result<bool, Broken> {
        if self.world.medium == Medium::Line && !self.world.replies.is_empty() {
            return Ok(false);
        }
        let (ours, theirs) = (motor_at(0), motor_at(2));
        for (motor, command, answer) in [(ours, READ, VALUES), (theirs, [0x92; 8], OF_THEIRS)] {
            self.receive(Packet { channel: Channel::Command(motor.into()), data: command })?;
            self.receive(Packet { channel: Channel::Reply(motor), data: answer })?;
        }
        Ok(!self.world.is_cut())
    }

    /// On a free line another master stops one of our motors. If the motor hears the stop, it answers before anything
    /// else is sent.
    pub(super) fn foreign_stop(&mut self, kind: StopKind, is_heard: bool) -> Result<bool, Broken> {
        let world = &mut self.world;
        let is_free = world.replies.is_empty() && !self.master.is_anything_in_flight();
        if world.medium != Medium::Line || !is_free || !world.fault() {
            return Ok(false);
        }
        let byte = if kind == StopKind::Hold { 0x81 } else { 0x80 };
        let channel = Channel::Command(Target::Motor(motor_at(0)));
        let packet = Packet { channel, data: [byte, 0, 0, 0, 0, 0, 0, 0] };
        self.receive(packet)?;
        if is_heard {
            self.world.stopped_by_another(packet);
            return self.reply(0, false);
        }
        Ok(true)
    }
}
