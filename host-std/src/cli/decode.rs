//! `myactuator decode`: what frames say.

use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::PathBuf;

use myactuator_host_std::explain::{Explainer, Explanation, FrameDirection, Rs485Stream};
use myactuator_host_std::text::can::LogLine;
use myactuator_host_std::{BusKind, text};

use super::arguments::Revision;
use super::{Outcome, Unfinished, names, print_line};

/// Explain frames: one line each for people, or with --json one object a line
///
/// On CAN a frame is ID#DATA or a line of candump or candump -L, whose time and interface are kept. On RS485 it is
/// bytes, hexadecimal or decimal, separated by commas, spaces or nothing; they may hold several frames and noise. An
/// input that cannot be read counts as wrong usage; the others are explained all the same.
///
/// Exit status: 0 every frame decoded, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The bus that the frames are from [default: can, with --binary rs485].
    #[arg(long, value_parser = names::bus())]
    bus: Option<BusKind>,
    /// Print one JSON object a line.
    #[arg(long)]
    json: bool,
    /// Files hold raw RS485 bytes, not text.
    #[arg(long)]
    binary: bool,
    /// Which way frames went whose bytes do not say it (RS485, and bus id on CAN).
    #[arg(long, value_parser = names::direction(), value_name = "WAY")]
    direction: Option<FrameDirection>,
    #[command(flatten)]
    revision: Revision,
    /// Frames, files, or - for standard input [default: standard input].
    #[arg(value_name = "FRAME|FILE|-")]
    inputs: Vec<String>,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let bus = match (arguments.bus, arguments.binary) {
        (Some(BusKind::Can), true) => {
            let sentence = "--binary: raw bytes are RS485's, but --bus can was given";
            return Err(sentence.to_owned().into());
        }
        (Some(bus), _) => bus,
        (None, true) => BusKind::Rs485,
        (None, false) => BusKind::Can,
    };
    let mut decoder = Decoder {
        arguments,
        bus,
        explainer: Explainer {
            firmware: arguments.revision.firmware,
            ranges: arguments.revision.motion_ranges(),
            direction: arguments.direction.unwrap_or(FrameDirection::Either),
        },
        all_decoded: true,
    };
    match decoder.inputs() {
        Ok(()) | Err(Unfinished::ReaderLeft) if !decoder.all_decoded => {
            Err(Unfinished::FailedAndReported)
        }
        outcome => outcome,
    }
}

struct Decoder<'a> {
    arguments: &'a Arguments,
    bus: BusKind,
    explainer: Explainer,
    all_decoded: bool,
}

impl Decoder<'_> {
    fn inputs(&mut self) -> Outcome {
        let mut unreadable = None;
        let only_standard_input = ["-".to_owned()];
        let mut rest = match self.arguments.inputs.as_slice() {
            [] => &only_standard_input,
            inputs => inputs,
        };
        while let [input, after @ ..] = rest {
            // The bytes of an RS485 frame may come as one argument or as many.
            let bytes = rest.iter().take_while(|input| self.are_bytes(input)).count();
            rest = if bytes > 0 {
                let (bytes, after) = rest.split_at(bytes);
                self.lines(bytes.join(" ").as_bytes())?;
                after
            } else {
                match self.input(input) {
                    // The others are still read.
                    Err(Unfinished::Usage(sentence)) => {
                        unreadable.get_or_insert(sentence);
                    }
                    other => other?,
                }
                after
            };
        }
        unreadable.map_or(Ok(()), |sentence| Err(Unfinished::Usage(sentence)))
    }

    fn are_bytes(&self, input: &str) -> bool {
        self.bus == BusKind::Rs485
            && !self.arguments.binary
            && text::rs485::parse_line(input).is_ok_and(|bytes| !bytes.is_empty())
    }

    /// Standard input, a frame or a file.
    fn input(&mut self, input: &str) -> Outcome {
        if input == "-" {
            return self.source(io::stdin().lock(), "standard input");
        }
        let path = PathBuf::from(input);
        let is_frame =
            text::can::parse_line(input).is_ok() || (input.contains(['#', '[']) && !path.exists());
        if self.bus == BusKind::Can && is_frame {
            return self.lines(input.as_bytes());
        }
        match File::open(&path) {
            Ok(file) => self.source(BufReader::new(file), input),
            Err(error) => Err(Unfinished::Usage(format!(
                "\"{input}\" is neither a frame on {} nor a file that can be read: {error}",
                self.bus
            ))),
        }
    }

    fn source(&mut self, mut source: impl BufRead, name: &str) -> Outcome {
        if !self.arguments.binary {
            return self.text(source, name);
        }
        let mut stream = Rs485Stream::new(self.explainer);
        let mut bytes = [0; 4096];
        loop {
            match source.read(&mut bytes) {
                Ok(0) => break,
                Ok(count) => self.print(stream.feed(&bytes[..count]))?,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(unreadable(name, &error)),
            }
        }
        self.print(stream.finish())
    }

    fn lines(&mut self, text: &[u8]) -> Outcome {
        self.text(text, "the arguments")
    }

    /// Text, line by line: a live bus is explained as it goes.
    fn text(&mut self, source: impl BufRead, name: &str) -> Outcome {
        let mut stream = Rs485Stream::new(self.explainer);
        for line in source.split(b'\n') {
            let line = line.map_err(|error| unreadable(name, &error))?;
            let line = String::from_utf8_lossy(&line);
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            match self.bus {
                BusKind::Can => {
                    let explanation = self.can_line(line);
                    self.print([explanation])?;
                }
                BusKind::Rs485 => match text::rs485::parse_line(line) {
                    Ok(bytes) => self.print(stream.feed(&bytes))?,
                    Err(error) => {
                        // A frame cannot go on after a line that is not understood.
                        self.print(stream.finish())?;
                        self.print([Explanation::no_frame(self.bus, line, error.to_string())])?;
                    }
                },
            }
        }
        self.print(stream.finish())
    }

    fn can_line(&self, line: &str) -> Explanation {
        let LogLine { stamp, rest, frame } = LogLine::read(line);
        let explanation = match frame {
            Ok(frame) => self.explainer.can_frame(&frame),
            Err(error) => {
                let bytes = text::rs485::parse_line(rest);
                let looks_like_rs485 = bytes.is_ok_and(|bytes| bytes.len() > 8);
                let hint = if looks_like_rs485 { " (for RS485 bytes add --bus rs485)" } else { "" };
                Explanation::no_frame(self.bus, rest, format!("{error}{hint}"))
            }
        };
        Explanation { stamp, ..explanation }
    }

    fn print(&mut self, explanations: impl IntoIterator<Item = Explanation>) -> Outcome {
        for explanation in explanations {
            self.all_decoded &= explanation.is_decoded();
            let line = if self.arguments.json {
                explanation.to_json().to_string()
            } else {
                explanation.to_string()
            };
            print_line(&line)?;
        }
        Ok(())
    }
}

fn unreadable(name: &str, error: &io::Error) -> Unfinished {
    Unfinished::Usage(format!("cannot read {name}: {error}"))
}
