//! Prints answers of a simulation for people.

use serde_json::Value;

/// The time, and a line for each motor in the answer.
pub(super) fn lines(answer: &Value) -> Vec<String> {
    let seconds = answer["at_us"].as_f64().unwrap_or_default() / 1e6;
    let mut lines = vec![format!("at {seconds:.6} s")];
    for bus in list(&answer["buses"]) {
        let traffic = &bus["traffic"];
        lines.push(format!(
            "{}: {} bit/s, {} frames carried, {} broken, {:.3} s busy",
            text(&bus["bus"]),
            bus["bit_rate"],
            traffic["frames"],
            traffic["broken"],
            traffic["busy_us"].as_f64().unwrap_or_default() / 1e6,
        ));
        if let Some(voltage_v) = bus["supply_voltage_v"].as_f64() {
            lines.push(format!(
                "  shared supply of {:.1} V: {voltage_v:.1} V",
                bus["supply"]["voltage_v"].as_f64().unwrap_or_default()
            ));
        }
        if let Some(reason) = bus["mechanics_failure"].as_str() {
            lines.push(format!("  mechanics have failed: {reason}"));
        }
        let motor = |it| motor(it, &bus["bit_rate"]);
        lines.extend(list(&bus["motors"]).map(motor));
    }
    lines
}

fn motor(motor: &Value, bus_rate: &Value) -> String {
    let number = |key: &str| motor[key].as_f64().unwrap_or_default();
    let is = |key: &str| motor[key] == true;
    let mut line = format!(
        "  motor {}: {:.2} deg, {:.1} dps, {:.2} A, {:.2} N·m (load {:.2} N·m), motor {:.0} °C, mosfet {:.0} °C, \
         {:.1} V",
        motor["motor"],
        number("angle_deg"),
        number("speed_dps"),
        number("current_a"),
        number("torque_nm"),
        number("load_torque_nm"),
        number("motor_temperature_c"),
        number("mosfet_temperature_c"),
        number("supply_voltage_v"),
    );
    let mut add = |part: &str| line.push_str(&format!(", {part}"));
    match motor["mode"].as_str() {
        Some(mode) => add(mode),
        None => add(if is("output_on") { "output on" } else { "output off" }),
    }
    add(&format!("brake {}", text(&motor["brake"])));
    if let Some(stuck) = motor["brake_stuck"].as_str() {
        add(&format!("stuck {stuck}"));
    }
    if is("led") {
        add("moved by mechanics");
    }
    if number("push_nm") != 0.0 {
        add(&format!("pushed by {:.2} N·m", number("push_nm")));
    }
    if motor["bit_rate"] != *bus_rate {
        add(&format!("hears {} bit/s only", motor["bit_rate"]));
    }
    if !is("powered") {
        add("without supply");
    } else if !is("running") {
        add("starting");
    }
    if is("communication_lost") {
        add("communication lost");
    }
    if is("cut") {
        add("cable cut");
    }
    for error in list(&motor["errors"]) {
        add(&format!("error {}", text(error)));
    }
    line
}

fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or("unknown")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_motor_is_a_line() {
        let answer = json!({
            "at_us": 1_500_000,
            "buses": [{
                "bus": "can", "bit_rate": 1_000_000,
                "traffic": { "frames": 12, "broken": 1, "busy_us": 2_000 },
                "supply": { "voltage_v": 48.0 }, "supply_voltage_v": 47.25,
                "mechanics_failure": "the engine has crashed",
                "motors": [{
                    "motor": 3, "bit_rate": 500_000, "angle_deg": 90.004, "speed_dps": -12.0, "current_a": 1.5, "torque_nm": 3.9,
                    "load_torque_nm": -3.9, "push_nm": -2.0, "motor_temperature_c": 25.0, "mosfet_temperature_c": 30.0,
                    "supply_voltage_v": 48.0, "mode": "speed", "output_on": true, "brake": "release", "brake_stuck": "locked", "led": true,
                    "powered": true, "running": true, "communication_lost": false, "cut": true,
                    "errors": ["stall"],
                }],
            }],
        });
        assert_eq!(
            lines(&answer),
            [
                "at 1.500000 s",
                "can: 1000000 bit/s, 12 frames carried, 1 broken, 0.002 s busy",
                "  shared supply of 48.0 V: 47.2 V",
                "  mechanics have failed: the engine has crashed",
                "  motor 3: 90.00 deg, -12.0 dps, 1.50 A, 3.90 N·m (load -3.90 N·m), motor 25 °C, mosfet 30 °C, \
                 48.0 V, speed, brake release, stuck locked, moved by mechanics, pushed by -2.00 N·m, hears 500000 bit/s only, cable cut, error stall",
            ]
        );
    }
}
