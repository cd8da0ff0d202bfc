//! The lines of a process's output, each of bounded length.
//! Uses: tokio. Never: the meaning of a line.

use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, BufReader};

/// Number of last lines that an error shows.
pub const TAIL_LINES: usize = 8;
/// Longest line, bytes; the rest of a longer one counts as the next line.
const LINE_BYTES_MAX: u64 = 1 << 16;

/// The lines of one output.
pub struct Lines<R> {
    output: Option<BufReader<R>>,
    /// Start of a line whose end was not read: a dropped `next` loses nothing.
    begun: Vec<u8>,
}

impl<R: AsyncRead + Unpin> Lines<R> {
    /// The lines of an output; none if there is no output.
    pub fn of(output: Option<R>) -> Self {
        Self { output: output.map(BufReader::new), begun: Vec::new() }
    }

    /// Returns the next line without its end; `None` at the end, or if it cannot be read.
    pub async fn next(&mut self) -> Option<String> {
        let left = LINE_BYTES_MAX.saturating_sub(self.begun.len() as u64);
        self.output.as_mut()?.take(left).read_until(b'\n', &mut self.begun).await.ok()?;
        let line = std::mem::take(&mut self.begun);
        let text = String::from_utf8_lossy(&line);
        (!line.is_empty()).then(|| text.trim_end_matches(['\n', '\r']).to_owned())
    }

    /// The last lines up to the end.
    pub async fn last(mut self) -> String {
        let mut last = Vec::new();
        while let Some(line) = self.next().await {
            push_last(&mut last, line);
        }
        last.join("\n")
    }
}

/// Appends a line, and drops the oldest of more than [`TAIL_LINES`].
pub fn push_last(last: &mut Vec<String>, line: String) {
    last.push(line);
    let over = last.len().saturating_sub(TAIL_LINES);
    last.drain(..over);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn lines_come_whole_and_the_last_ones_are_kept() {
        let text = "one\r\ntwo\n\nfour";
        let mut lines = Lines::of(Some(text.as_bytes()));
        let mut found = Vec::new();
        while let Some(line) = lines.next().await {
            found.push(line);
        }
        assert_eq!(found, ["one", "two", "", "four"]);
        let many: String = (0..20).map(|n| format!("{n}\n")).collect();
        assert_eq!(Lines::of(Some(many.as_bytes())).last().await, "12\n13\n14\n15\n16\n17\n18\n19");
        let long = "x".repeat(100_000);
        assert_eq!(Lines::of(Some(long.as_bytes())).next().await.map(|l| l.len()), Some(1 << 16));
    }
}
