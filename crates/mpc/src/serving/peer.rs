//! The plants of a server, and what they hear.

use std::io::{self, Write};

use serde::Serialize;

use super::message::{CommandLine, ErrorLine, Hello, Served};

/// A line of the server.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Said<'a> {
    /// The first one.
    Hello(&'a Hello<'a>),
    /// A fault in a line of the plant.
    Error(ErrorLine),
    /// The answer to a measurement.
    Command(Box<CommandLine>),
    /// The last one.
    Summary(&'a Served),
}

/// A plant that hears the lines of a server: any [writer](Write), as a line of JSON each, or [`Heard`] in the same process.
pub trait Peer {
    /// Takes a line.
    ///
    /// # Errors
    /// Returns an error if the plant cannot be reached.
    fn hear(&mut self, said: Said) -> io::Result<()>;
}

impl<W: Write> Peer for W {
    fn hear(&mut self, said: Said) -> io::Result<()> {
        let mut text = serde_json::to_vec(&said)?;
        text.push(b'\n');
        self.write_all(&text)?;
        self.flush()
    }
}

/// The lines of a server to a plant in the same process, without text in between.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// The first line, as JSON.
    pub hello: String,
    /// Faults in the last measurement.
    pub errors: Vec<ErrorLine>,
    /// The answer to the last measurement; `None` where this was a goodbye.
    pub command: Option<Box<CommandLine>>,
}

impl Heard {
    /// Returns the answer to the last measurement as lines of JSON, faults first.
    #[must_use]
    pub fn lines(&self) -> String {
        let errors = self.errors.iter().map(serde_json::to_string);
        let lines = errors.chain(self.command.iter().map(serde_json::to_string));
        lines.flatten().map(|line| line + "\n").collect()
    }
}

impl Peer for Heard {
    fn hear(&mut self, said: Said) -> io::Result<()> {
        match said {
            Said::Hello(_) => self.hello = serde_json::to_string(&said)?,
            Said::Error(error) => self.errors.push(error),
            Said::Command(command) => self.command = Some(command),
            Said::Summary(_) => {}
        }
        Ok(())
    }
}
