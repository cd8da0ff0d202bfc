//! Server-sent events: the bytes of a stream as events.
//! PURE. Uses: no other module. Never: HTTP, a line that has not ended.

/// An event as it was sent.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Sent {
    /// Number of the event, with which a client continues.
    pub id: String,
    /// Its data: all its lines.
    pub data: String,
}

/// Collects bytes and returns the events that are complete.
#[derive(Debug, Default)]
pub struct Collect {
    waiting: Vec<u8>,
    event: Sent,
}

impl Collect {
    /// Takes the next bytes of the stream; returns the events that they complete.
    pub fn take(&mut self, bytes: &[u8]) -> Vec<Sent> {
        self.waiting.extend_from_slice(bytes);
        let mut done = Vec::new();
        while let Some(end) = self.waiting.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.waiting.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line);
            self.line(line.trim_end_matches(['\r', '\n']), &mut done);
        }
        done
    }

    fn line(&mut self, line: &str, done: &mut Vec<Sent>) {
        if line.is_empty() {
            let event = std::mem::take(&mut self.event);
            if !event.data.is_empty() {
                done.push(event);
            }
            return;
        }
        let (field, value) = line.split_once(':').unwrap_or((line, ""));
        let value = value.strip_prefix(' ').unwrap_or(value);
        match field {
            "id" => self.event.id = value.into(),
            "data" => {
                if !self.event.data.is_empty() {
                    self.event.data.push('\n');
                }
                self.event.data += value;
            }
            // Comments keep the connection alive.
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_complete_however_the_stream_is_cut() {
        let stream =
            b":\n\nid: 7\nevent: trip\ndata: {\"a\":\r\ndata: 1}\n\nid: 8\ndata: {}\n\nid: 9\n";
        let whole = Collect::default().take(stream);
        let event = |id: &str, data: &str| Sent { id: id.into(), data: data.into() };
        assert_eq!(whole, [event("7", "{\"a\":\n1}"), event("8", "{}")]);
        for size in [1, 3, 10] {
            let mut collect = Collect::default();
            let pieces = stream.chunks(size).flat_map(|piece| collect.take(piece));
            assert_eq!(pieces.collect::<Vec<_>>(), whole, "pieces of {size} bytes");
        }
    }
}
