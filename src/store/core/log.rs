//! Damage in SQLite's write-ahead log that SQLite does not report: it reads the log up to the first
//! frame with a wrong checksum and ignores the rest, as after a crash.
//! PURE: bytes in, a finding out. Uses: std. Never: the file itself.
//! Format: `https://sqlite.org/fileformat2.html`, section 4.
//!
//! With `synchronous = FULL` a transaction is on the disk before the next one begins. A crash can
//! therefore damage only the last transaction of the log, which is not yet acknowledged. Remains of
//! several crashes may follow it, but none of them continues another. If a committed transaction behind
//! a wrong frame is continued by the next frame, checksum by checksum, then stored data was changed.
//! Damage in the last transaction cannot be distinguished from a crash and is not found.

/// Size of the header of the log, bytes.
const LOG_HEADER: usize = 32;
/// Size of the header of a frame, bytes.
const FRAME_HEADER: usize = 24;

/// Position and extent of the damage of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogDamage {
    /// Offset of the first frame that differs from what was written, bytes; 0 for the header of the log.
    pub at_byte: usize,
    /// Number of transactions at and after this offset, all of which were stored.
    pub transactions: usize,
}

/// Returns the damage of a log; `None` if it is empty, complete, or incomplete at its end after a crash.
pub fn damage(log: &[u8]) -> Option<LogDamage> {
    let frames = |page: usize| log[LOG_HEADER..].chunks_exact(FRAME_HEADER + page);
    let header = log.get(..LOG_HEADER)?;
    let page = word(header, 8) as usize;
    let big_endian = word(header, 0) & 1 == 1;
    let mut sum = checksum(big_endian, (0, 0), &header[..24]);
    let known = word(header, 0) & !1 == 0x377f_0682 && page.is_power_of_two() && page >= 512;
    if !known || sum != (word(header, 24), word(header, 28)) {
        // The header is on the disk before the first frame is written.
        let written = log[LOG_HEADER..].iter().any(|byte| *byte != 0);
        return written.then_some(LogDamage { at_byte: 0, transactions: 1 });
    }
    let salt = &header[16..24];
    let is_sound = |frame: &&[u8]| {
        sum = checksum(big_endian, sum, &frame[..8]);
        sum = checksum(big_endian, sum, &frame[FRAME_HEADER..]);
        &frame[8..16] == salt && sum == (word(frame, 16), word(frame, 20))
    };
    let sound = frames(page).take_while(is_sound).count();
    // Frames from before the last reset of the log have another salt.
    let rest: Vec<&[u8]> = frames(page).skip(sound).collect();
    let commits = |frame: &[u8]| &frame[8..16] == salt && word(frame, 4) != 0;
    let continues = |pair: &[&[u8]]| {
        let (before, next) = (pair[0], pair[1]);
        let sum = checksum(big_endian, (word(before, 16), word(before, 20)), &next[..8]);
        let sum = checksum(big_endian, sum, &next[FRAME_HEADER..]);
        &next[8..16] == salt && sum == (word(next, 16), word(next, 20))
    };
    let stored = rest.windows(2).any(|pair| commits(pair[0]) && continues(pair));
    let transactions = rest.iter().filter(|frame| commits(frame)).count();
    let at_byte = LOG_HEADER + sound * (FRAME_HEADER + page);
    stored.then_some(LogDamage { at_byte, transactions })
}

/// Returns the big-endian u32 at this offset.
fn word(bytes: &[u8], at: usize) -> u32 {
    bytes[at..at + 4].iter().fold(0, |number, byte| number << 8 | u32::from(*byte))
}

/// Returns the running checksum of the log, continued over pairs of 32-bit words.
fn checksum(big_endian: bool, (mut a, mut b): (u32, u32), bytes: &[u8]) -> (u32, u32) {
    let read = |word: &[u8; 4]| match big_endian {
        true => u32::from_be_bytes(*word),
        false => u32::from_le_bytes(*word),
    };
    for pair in bytes.as_chunks::<4>().0.as_chunks::<2>().0 {
        a = a.wrapping_add(read(&pair[0])).wrapping_add(b);
        b = b.wrapping_add(read(&pair[1])).wrapping_add(a);
    }
    (a, b)
}
