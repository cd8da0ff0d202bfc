//! The overlay for placing weights, read by another program: the size of its pages, and the names on them.
//! Without poppler's tools the test reports that it was skipped, or fails with `PALPATE_REQUIRE_TOOLS=1`.

use std::process::Command;

use palpate::overlay::{Paper, pdf};

use crate::datasets::filled::Filled;
use crate::support::{Folder, command, left_out, sensor, succeeded};

/// Output of a tool; `None` if it is missing.
fn tool(name: &str, args: &[&str]) -> Option<String> {
    match Command::new(name).args(args).output() {
        Ok(output) => {
            assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
            Some(String::from_utf8_lossy(&output.stdout).into_owned())
        }
        Err(_) => left_out(&format!("no {name}")),
    }
}

/// Value of a line of pdfinfo.
fn info<'a>(text: &'a str, key: &str) -> &'a str {
    let line = text.lines().find_map(|line| line.strip_prefix(key));
    line.unwrap_or_else(|| panic!("{key}: {text}")).trim_start_matches(':').trim()
}

#[test]
fn the_overlay_has_its_pages_at_true_scale_and_every_name() {
    let folder = Folder::new("overlay");
    for (paper, pages, [width_mm, height_mm]) in
        [("a4", "9", [210.0, 297.0]), ("sheet", "1", [571.0, 603.0])]
    {
        let path = folder.path(&format!("{paper}.pdf"));
        let mut make = command(&["sensor", "overlay", "--paper", paper, "--out", &path]);
        let made = make.output().unwrap();
        succeeded(&made);
        let next = String::from_utf8(made.stderr).unwrap();
        assert!(next.contains("palpate plan real-random"), "{next}");
        let Some(facts) = tool("pdfinfo", &[&path]) else { return };
        assert_eq!(info(&facts, "Pages"), pages);
        let size: Vec<f64> =
            info(&facts, "Page size").split(' ').filter_map(|word| word.parse().ok()).collect();
        for (points, mm) in size.iter().zip([width_mm, height_mm]) {
            assert!((points / 72.0 * 25.4 - mm).abs() < 0.1, "{size:?}");
        }
        let Some(text) = tool("pdftotext", &["-layout", &path, "-"]) else { return };
        let words: Vec<&str> = text.split_whitespace().collect();
        let pairs: Vec<String> = words.windows(2).map(|pair| pair.join(" ")).collect();
        let missing: Vec<String> = sensor()
            .points()
            .iter()
            .map(|point| point.label())
            .filter(|label| !pairs.contains(label))
            .collect();
        assert!(missing.is_empty(), "{paper}: {missing:?}");
        for electrode in 0..28 {
            assert!(words.contains(&format!("E{electrode}").as_str()), "{paper}: E{electrode}");
        }
        assert!(text.contains("100 mm"), "{paper}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_service_sends_the_same_overlay() {
    let lab = Filled::open("overlay").await;
    for (query, paper) in [("", Paper::A4), ("?paper=sheet", Paper::Sheet), ("?run=1", Paper::A4)] {
        let url = lab.url(&format!("/api/v1/sensor/overlay.pdf{query}"));
        let answer = lab.http.get(url).send().await.unwrap();
        assert_eq!(answer.headers()["content-type"], "application/pdf", "{query}");
        assert_eq!(answer.bytes().await.unwrap(), pdf(&sensor(), paper), "{query}");
    }
    let url = lab.url("/api/v1/sensor/overlay.pdf?paper=a5");
    assert_eq!(lab.http.get(url).send().await.unwrap().status(), 400);
    let none = lab.http.get(lab.url("/api/v1/placement")).send().await.unwrap();
    assert_eq!(none.status(), 404);
    lab.end().await;
}
