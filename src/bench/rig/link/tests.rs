//! A line against a faulty device: what it sends, how often, and in which order.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::sync::{Notify, mpsc};

use super::*;
use crate::clock::Clock;

const TIMEOUT: Duration = Duration::from_millis(80);
/// A deadline that is not reached even on a loaded machine.
const LONG: Duration = Duration::from_secs(2);
const GRACE: Duration = Duration::from_millis(10);

/// Reaction of the device to a request.
enum Act {
    Echo,
    Words(Vec<u16>),
    Exception(u8),
    Silence,
    Late(Duration),
    Hangup,
    /// The words of a server that is no Modbus device.
    Http,
}

/// A request as received by the device: unit, function, address.
type Asked = (u8, u8, u16);

async fn serve(
    mut wires: mpsc::Receiver<DuplexStream>,
    mut script: impl FnMut(usize, Asked) -> Act + Send,
    log: mpsc::Sender<Asked>,
) {
    let mut n = 0;
    while let Some(mut wire) = wires.recv().await {
        let mut head = [0; 7];
        while wire.read_exact(&mut head).await.is_ok() {
            let mut pdu = vec![0; usize::from(u16::from_be_bytes([head[4], head[5]])) - 1];
            wire.read_exact(&mut pdu).await.unwrap();
            let asked = (head[6], pdu[0], u16::from_be_bytes([pdu[1], pdu[2]]));
            log.send(asked).await.unwrap();
            let answer = match script(n, asked) {
                Act::Echo => pdu[..5].to_vec(),
                Act::Words(words) => {
                    let bytes = words.iter().flat_map(|w| w.to_be_bytes());
                    [pdu[0], 2 * words.len() as u8].into_iter().chain(bytes).collect()
                }
                Act::Exception(code) => vec![pdu[0] | 0x80, code],
                Act::Silence => Vec::new(),
                Act::Late(wait) => {
                    tokio::time::sleep(wait).await;
                    pdu[..5].to_vec()
                }
                Act::Hangup => break,
                Act::Http => {
                    wire.write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n").await.unwrap();
                    break;
                }
            };
            n += 1;
            if !answer.is_empty() {
                let length = (answer.len() as u16 + 1).to_be_bytes();
                head[4..6].copy_from_slice(&length);
                let frame: Vec<u8> = head.iter().chain(&answer).copied().collect();
                if wire.write_all(&frame).await.is_err() {
                    break;
                }
            }
        }
        n += 1;
    }
}

struct Rig {
    line: Arc<Line>,
    asked: mpsc::Receiver<Asked>,
}

/// A line that asks three times.
fn line(framing: Framing, timeout: Duration, opener: Opener) -> Arc<Line> {
    let policy = LinePolicy { timeout, attempts: 3, silence: Duration::ZERO, stop_grace: GRACE };
    Arc::new(Line::spawn(framing, "rig:502", opener, policy, Clock::new(1.0)))
}

/// What opens a wire, and its ends at the device, one for each time that it is opened.
fn opener() -> (Opener, mpsc::Receiver<DuplexStream>) {
    let (wires_in, wires) = mpsc::channel(4);
    let opener: Opener = Box::new(move || {
        let wires = wires_in.clone();
        Box::pin(async move {
            let (ours, theirs) = tokio::io::duplex(1024);
            wires.send(theirs).await.map_err(|_| std::io::ErrorKind::ConnectionRefused)?;
            Ok(Box::new(ours) as Box<dyn Port>)
        })
    });
    (opener, wires)
}

fn rig(script: impl FnMut(usize, Asked) -> Act + Send + 'static) -> Rig {
    patient_rig(TIMEOUT, script)
}

fn patient_rig(timeout: Duration, script: impl FnMut(usize, Asked) -> Act + Send + 'static) -> Rig {
    let (opener, wires) = opener();
    let (log, asked) = mpsc::channel(100);
    tokio::spawn(serve(wires, script, log));
    Rig { line: line(Framing::Tcp, timeout, opener), asked }
}

impl Rig {
    fn seen(&mut self) -> Vec<Asked> {
        std::iter::from_fn(|| self.asked.try_recv().ok()).collect()
    }
}

fn read() -> Request {
    Request::ReadHolding { address: 0x9000, count: 1 }
}

fn coil(address: u16) -> Request {
    Request::WriteCoil { address, on: true }
}

/// The permit of a motion that no stop voids.
fn permit() -> MotionPermit {
    MotionGate::new(StopLatch::default()).permit().unwrap()
}

#[tokio::test]
async fn a_silent_device_is_asked_three_times_over_fresh_connections() {
    let mut rig = rig(|_, _| Act::Silence);
    let error = rig.line.ask(1, read()).await.unwrap_err();
    assert_eq!(error, LineError::NoReply { timeout_ms: 80 });
    assert_eq!(rig.seen().len(), 3);
    let counts = rig.line.counts();
    assert_eq!((counts.timeouts, counts.retries, counts.reconnects), (3, 2, 2));
}

#[tokio::test]
async fn a_server_that_is_no_modbus_device_is_named_by_its_address() {
    let rig = patient_rig(LONG, |_, _| Act::Http);
    let error = rig.line.ask(1, read()).await.unwrap_err();
    let words = "wire lost: rig:502: the answer is not a Modbus reply, or only the start of one; \
                 check the address";
    assert_eq!(error.to_string(), words);
}

#[tokio::test]
async fn a_reply_on_the_second_attempt_is_taken_and_a_late_one_is_not() {
    let mut rig = rig(|n, _| match n {
        0 => Act::Late(2 * TIMEOUT),
        _ => Act::Words(vec![42]),
    });
    assert_eq!(rig.line.ask(1, read()).await, Ok(Reply::Words(vec![42])));
    assert_eq!(rig.seen().len(), 2);
}

#[tokio::test]
async fn a_lost_connection_is_opened_again() {
    let mut rig = rig(|n, _| if n == 0 { Act::Hangup } else { Act::Words(vec![7]) });
    assert_eq!(rig.line.ask(1, read()).await, Ok(Reply::Words(vec![7])));
    assert_eq!((rig.seen().len(), rig.line.counts().reconnects), (2, 1));
}

#[tokio::test]
async fn setup_errors_and_failed_devices_are_not_retried() {
    for code in [1, 2, 3, 4] {
        let mut rig = rig(move |_, _| Act::Exception(code));
        assert_eq!(rig.line.ask(1, read()).await, Err(LineError::Exception { code }));
        assert_eq!((rig.seen().len(), rig.line.counts().reconnects), (1, 0));
    }
}

#[tokio::test]
async fn a_busy_device_is_waited_for_but_not_for_ever() {
    let mut patient = rig(|n, _| if n < 4 { Act::Exception(6) } else { Act::Words(vec![1]) });
    assert!(patient.line.ask(1, read()).await.is_ok());
    assert_eq!(patient.seen().len(), 5);
    let stubborn = rig(|_, _| Act::Exception(5));
    let asked = Instant::now();
    assert_eq!(stubborn.line.ask(1, read()).await, Err(LineError::Exception { code: 5 }));
    assert!(asked.elapsed() < 3 * TIMEOUT + LONG / 2);
}

#[tokio::test]
async fn a_gateways_exception_is_retried_once_over_a_fresh_connection() {
    for code in [8, 0x0B] {
        let mut rig = rig(move |_, _| Act::Exception(code));
        assert_eq!(rig.line.ask(1, read()).await, Err(LineError::Exception { code }));
        assert_eq!((rig.seen().len(), rig.line.counts().reconnects), (2, 1));
    }
}

#[tokio::test]
async fn a_motion_that_may_have_been_received_is_handed_back_not_repeated() {
    for (code, sent) in [(5, 1), (6, 3), (8, 1), (0x0A, 2), (0x0B, 1)] {
        let mut rig = rig(move |n, _| match code {
            6 if n == 2 => Act::Echo,
            _ => Act::Exception(code),
        });
        // A busy device (6) has refused it, and a gateway without a path (0xA) has not passed it on.
        let accepted = rig.line.ask_motion(1, coil(1), permit()).await.is_ok();
        assert_eq!((rig.seen().len(), accepted), (sent, code == 6), "exception {code}");
    }
}

#[tokio::test]
async fn a_stop_overtakes_and_voids_the_motions_that_waited() {
    let mut rig = rig(|n, _| if n == 0 { Act::Late(GRACE / 2) } else { Act::Echo });
    let gate = MotionGate::new(StopLatch::default());
    let permit = gate.permit().unwrap();
    let ask = |address, permit: Option<MotionPermit>| {
        let line = Arc::clone(&rig.line);
        tokio::spawn(async move {
            match permit {
                Some(permit) => line.ask_motion(1, coil(address), permit).await,
                None => line.ask(1, coil(address)).await,
            }
        })
    };
    let first = ask(1, None);
    assert!(rig.asked.recv().await.is_some(), "the first request is in flight");
    let moves = [ask(2, Some(permit.clone())), ask(3, Some(permit))];
    tokio::task::yield_now().await;
    gate.void();
    rig.line.ask_urgent(1, coil(9)).await.unwrap();
    assert!(first.await.unwrap().is_ok());
    for one in moves {
        assert_eq!(one.await.unwrap(), Err(LineError::Withdrawn));
    }
    assert_eq!(rig.seen(), [(1, 5, 9)]);
}

#[tokio::test]
async fn a_stop_cuts_off_a_request_that_hangs_and_the_request_goes_on_after_it() {
    let mut rig = patient_rig(LONG, |n, _| if n == 0 { Act::Silence } else { Act::Echo });
    let line = Arc::clone(&rig.line);
    let hanging = tokio::spawn(async move { line.ask(2, coil(1)).await });
    assert_eq!(rig.asked.recv().await, Some((2, 5, 1)));
    let asked = Instant::now();
    rig.line.ask_urgent(1, coil(9)).await.unwrap();
    assert!(asked.elapsed() < LONG / 2, "{:?}", asked.elapsed());
    assert!(hanging.await.unwrap().is_ok());
    assert_eq!(rig.seen(), [(1, 5, 9), (2, 5, 1)]);
    assert_eq!(rig.line.counts().cut_off, 1);
}

#[tokio::test]
async fn a_motion_that_a_stop_cut_off_is_handed_back_not_repeated() {
    let mut rig = patient_rig(LONG, |n, _| if n == 0 { Act::Silence } else { Act::Echo });
    let line = Arc::clone(&rig.line);
    let hanging = tokio::spawn(async move { line.ask_motion(2, coil(1), permit()).await });
    assert_eq!(rig.asked.recv().await, Some((2, 5, 1)));
    rig.line.ask_urgent(1, coil(9)).await.unwrap();
    assert!(matches!(hanging.await.unwrap(), Err(LineError::NoReply { .. })));
    assert_eq!(rig.seen(), [(1, 5, 9)]);
}

#[tokio::test]
async fn one_silent_drive_does_not_keep_the_others_from_stopping() {
    let mut rig =
        patient_rig(LONG / 4, |_, (unit, ..)| if unit == 1 { Act::Silence } else { Act::Echo });
    let stops = [1, 2, 3].map(|unit| {
        let line = Arc::clone(&rig.line);
        tokio::spawn(async move {
            let asked = Instant::now();
            (line.ask_urgent(unit, coil(9)).await, asked.elapsed())
        })
    });
    let [first, second, third] = stops;
    for other in [second, third] {
        let (answer, took) = other.await.unwrap();
        assert!(answer.is_ok() && took < LONG / 2, "{answer:?} after {took:?}");
    }
    assert!(first.await.unwrap().0.is_err());
    assert_eq!(rig.seen().iter().filter(|(unit, ..)| *unit == 1).count(), 3);
}

#[tokio::test]
async fn a_silent_drive_does_not_keep_the_raise_of_another_waiting() {
    let mut rig =
        patient_rig(LONG / 4, |_, (unit, ..)| if unit == 2 { Act::Silence } else { Act::Echo });
    let stop_of_2 = |line: &Arc<Line>| {
        let line = Arc::clone(line);
        tokio::spawn(async move { line.ask_urgent(2, coil(9)).await })
    };
    // It is not known to be silent: its first stop is waited for, and not those after it.
    let silent = stop_of_2(&rig.line);
    assert_eq!(rig.asked.recv().await, Some((2, 5, 9)));
    rig.line.ask_motion(1, coil(1), permit()).await.unwrap();
    assert!(silent.await.unwrap().is_err());
    assert_eq!(rig.seen(), [(1, 5, 1), (2, 5, 9), (2, 5, 9)]);
    // From now on it is known.
    let silent = stop_of_2(&rig.line);
    assert_eq!(rig.asked.recv().await, Some((2, 5, 9)));
    let asked = Instant::now();
    rig.line.ask_motion(1, coil(1), permit()).await.unwrap();
    assert!(asked.elapsed() < LONG / 5, "{:?}", asked.elapsed());
    assert!(silent.await.unwrap().is_err());
    assert_eq!(rig.seen(), [(1, 5, 1), (2, 5, 9), (2, 5, 9)]);
}

/// Sends the stop of a device again and again, as while an e-stop is latched.
fn stop_again(line: &Arc<Line>, unit: u8) -> tokio::task::JoinHandle<()> {
    let line = Arc::clone(line);
    tokio::spawn(async move {
        loop {
            let _ = line.ask_urgent(unit, coil(9)).await;
            tokio::time::sleep(GRACE / 2).await;
        }
    })
}

#[tokio::test]
async fn a_request_to_a_silent_device_ends_although_its_stop_is_sent_again() {
    let rig = rig(|_, _| Act::Silence);
    let stopping = stop_again(&rig.line, 1);
    let read = tokio::time::timeout(5 * LONG, rig.line.ask(1, read())).await;
    assert!(matches!(read, Ok(Err(LineError::NoReply { .. }))), "{read:?}");
    stopping.abort();
}

#[tokio::test]
async fn several_silent_drives_do_not_keep_a_request_to_another_device_waiting() {
    let rig = rig(|_, (unit, ..)| if unit == 3 { Act::Words(vec![3]) } else { Act::Silence });
    let stopping = [1, 2].map(|unit| stop_again(&rig.line, unit));
    tokio::time::sleep(TIMEOUT / 2).await;
    let read = tokio::time::timeout(5 * LONG, rig.line.ask(3, read())).await;
    assert_eq!(read, Ok(Ok(Reply::Words(vec![3]))));
    stopping.iter().for_each(tokio::task::JoinHandle::abort);
}

#[tokio::test]
async fn a_latched_rig_sends_no_motion_but_reads_and_stops() {
    let mut rig = rig(|_, (_, f, _)| if f == 3 { Act::Words(vec![1]) } else { Act::Echo });
    let latch = StopLatch::default();
    let permit = MotionGate::new(latch.clone()).permit().unwrap();
    latch.latch();
    assert_eq!(rig.line.ask_motion(1, coil(1), permit.clone()).await, Err(LineError::Latched));
    assert!(rig.line.ask(1, read()).await.is_ok());
    assert!(rig.line.ask_urgent(1, coil(9)).await.is_ok());
    assert_eq!(rig.seen(), [(1, 3, 0x9000), (1, 5, 9)]);
    latch.clear();
    assert!(rig.line.ask_motion(1, coil(1), permit).await.is_ok());
}

#[tokio::test]
async fn a_motion_whose_wire_opens_after_the_stop_was_latched_is_not_sent() {
    let (ours, mut theirs) = tokio::io::duplex(64);
    let (begun, go) = (Arc::<Notify>::default(), Arc::<Notify>::default());
    let (begins, goes, mut port) = (Arc::clone(&begun), Arc::clone(&go), Some(ours));
    let opener: Opener = Box::new(move || {
        let (begins, goes, port) = (Arc::clone(&begins), Arc::clone(&goes), port.take());
        Box::pin(async move {
            begins.notify_one();
            goes.notified().await;
            let port = port.ok_or(std::io::ErrorKind::ConnectionRefused)?;
            Ok(Box::new(port) as Box<dyn Port>)
        })
    });
    let line = line(Framing::Tcp, LONG, opener);
    let latch = StopLatch::default();
    let permit = MotionGate::new(latch.clone()).permit().unwrap();
    let asking = Arc::clone(&line);
    let moving = tokio::spawn(async move { asking.ask_motion(1, coil(1), permit).await });
    begun.notified().await;
    latch.latch();
    go.notify_one();
    assert_eq!(moving.await.unwrap(), Err(LineError::Latched));
    let sent = tokio::time::timeout(TIMEOUT, theirs.read_u8()).await;
    assert!(sent.is_err(), "nothing is sent: {sent:?}");
}

#[tokio::test]
async fn requests_to_several_devices_share_the_wire_one_at_a_time() {
    let mut rig = rig(|_, (unit, ..)| Act::Words(vec![u16::from(unit)]));
    let asks = (1..=20).map(|unit| {
        let line = Arc::clone(&rig.line);
        async move { (unit, line.ask(unit, read()).await) }
    });
    for (unit, answer) in futures::future::join_all(asks).await {
        assert_eq!(answer, Ok(Reply::Words(vec![u16::from(unit)])));
    }
    assert_eq!(rig.seen().len(), 20);
}

/// Bytes on a serial line: a read of one register and two answers to it, and a write of a coil with its echo.
const READ: [u8; 8] = [1, 3, 0x90, 0, 0, 1, 0xA9, 0x0A];
const SEVEN: [u8; 7] = [1, 3, 2, 0, 7, 0xF9, 0x86];
const THIRTEEN: [u8; 7] = [1, 3, 2, 0, 13, 0x79, 0x81];
const STOP: [u8; 8] = [1, 5, 0, 9, 0xFF, 0, 0x5C, 0x38];

/// A serial line, and its ends at the device, one for each time that it is opened.
fn serial(timeout: Duration) -> (Arc<Line>, mpsc::Receiver<DuplexStream>) {
    let (opener, wires) = opener();
    (line(Framing::Rtu, timeout, opener), wires)
}

/// Waits for a request on a serial line; false once it is closed.
async fn is_asked<const N: usize>(wire: &mut DuplexStream, request: [u8; N]) -> bool {
    let mut found = [0; N];
    let is_open = wire.read_exact(&mut found).await.is_ok();
    assert!(!is_open || found == request, "{found:?}");
    is_open
}

#[tokio::test]
async fn a_serial_reply_that_a_stop_did_not_wait_for_is_no_answer_to_the_next_read() {
    let (line, mut wires) = serial(LONG);
    let asking = Arc::clone(&line);
    let reading = tokio::spawn(async move { asking.ask(1, read()).await });
    let mut first = wires.recv().await.unwrap();
    assert!(is_asked(&mut first, READ).await);
    let stopping = tokio::spawn(async move { line.ask_urgent(1, coil(9)).await });
    let mut second = wires.recv().await.unwrap();
    assert!(is_asked(&mut second, STOP).await);
    second.write_all(&STOP).await.unwrap();
    assert!(stopping.await.unwrap().is_ok(), "a stop does not wait for it");
    // The read is sent again once the reply to the first has arrived.
    if is_asked(&mut second, READ).await {
        second.write_all(&THIRTEEN).await.unwrap();
    } else {
        let mut third = wires.recv().await.unwrap();
        tokio::time::sleep(Duration::from_millis(100)).await;
        third.write_all(&THIRTEEN).await.unwrap();
        assert!(is_asked(&mut third, READ).await);
        third.write_all(&SEVEN).await.unwrap();
    }
    assert_eq!(reading.await.unwrap(), Ok(Reply::Words(vec![7])));
}

/// Writes of two words to one address, such as the release of a stop and a stop, the echo of both, and an exception.
const RELEASE: [u8; 13] = [1, 16, 0, 0x7C, 0, 2, 4, 0, 0, 0, 0, 0xF4, 0xDE];
const STOP_WORDS: [u8; 13] = [1, 16, 0, 0x7C, 0, 2, 4, 0, 0, 0, 32, 0xF5, 0x06];
const ECHO: [u8; 8] = [1, 16, 0, 0x7C, 0, 2, 0x80, 0x10];
const FAILED: [u8; 5] = [1, 0x90, 4, 0x4D, 0xC3];

#[tokio::test]
async fn a_serial_echo_that_may_be_of_an_earlier_write_acknowledges_no_stop() {
    a_reply_to_an_earlier_write_answers_no_stop(&ECHO).await;
}

#[tokio::test]
async fn a_serial_exception_that_may_be_of_an_earlier_write_fails_no_stop() {
    a_reply_to_an_earlier_write_answers_no_stop(&FAILED).await;
}

async fn a_reply_to_an_earlier_write_answers_no_stop(reply: &[u8]) {
    let (line, mut wires) = serial(LONG);
    let write = |word| Request::WriteRegisters { address: 0x7C, words: vec![0, word] };
    let asking = Arc::clone(&line);
    let releasing = tokio::spawn(async move { asking.ask_motion(1, write(0), permit()).await });
    let mut first = wires.recv().await.unwrap();
    assert!(is_asked(&mut first, RELEASE).await);
    let stopping = tokio::spawn(async move { line.ask_urgent(1, write(32)).await });
    let mut second = wires.recv().await.unwrap();
    assert!(is_asked(&mut second, STOP_WORDS).await);
    second.write_all(reply).await.unwrap();
    // It may be that of the release.
    let mut third = wires.recv().await.expect("the stop is sent again");
    assert!(is_asked(&mut third, STOP_WORDS).await);
    third.write_all(&ECHO).await.unwrap();
    assert!(stopping.await.unwrap().is_ok() && releasing.await.unwrap().is_err());
}

#[tokio::test]
async fn a_serial_reply_that_is_late_is_awaited_before_the_same_read_is_sent_again() {
    let (line, mut wires) = serial(LONG / 4);
    let asked = Instant::now();
    let reading = tokio::spawn(async move { line.ask(1, read()).await });
    let mut first = wires.recv().await.unwrap();
    assert!(is_asked(&mut first, READ).await);
    let mut second = wires.recv().await.unwrap();
    assert!(is_asked(&mut second, READ).await);
    assert!(asked.elapsed() >= LONG / 4 + Duration::from_millis(50), "{:?}", asked.elapsed());
    second.write_all(&SEVEN).await.unwrap();
    assert_eq!(reading.await.unwrap(), Ok(Reply::Words(vec![7])));
}
