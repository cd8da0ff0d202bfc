//! Statements that are large, or cause much work: deep nesting, long texts, wide lists, products of tables,
//! regular expressions.
//! Uses: nothing. Never: more than the bounds of the program can hold.

use super::Expected::{Bounded, Refused};
use super::{Kind, kind};

fn long(times: usize, of: impl Fn(usize) -> String, separator: &str) -> String {
    (0..times).map(of).collect::<Vec<_>>().join(separator)
}

fn nested(start: &str, times: usize, end: &str) -> String {
    format!("SELECT {}1{}", start.repeat(times), end.repeat(times))
}

pub(super) fn kinds() -> Vec<Kind> {
    let mut kinds = Vec::new();
    let deep = [
        nested("(", 60, ")"),
        nested("(", 20_000, ")"),
        nested("abs(", 10_000, ")"),
        nested("-", 60_000, ""),
        nested("- ", 30_000, ""),
        nested("NOT ", 15_000, ""),
        nested("[", 30_000, "]"),
        nested("(SELECT ", 5_000, ")"),
        nested("CASE WHEN true THEN ", 2_000, " END"),
        nested("CAST(", 5_000, " AS INT)"),
        nested("1 + (", 8_000, ")"),
        format!("SELECT {}", long(20_000, |_| "1".into(), "+")),
        format!("SELECT * FROM trials WHERE {}", long(6_000, |_| "tips=1".into(), " OR ")),
        format!("SELECT {}", long(10_000, |_| "'a'".into(), "||")),
        format!("SELECT * FROM {}trials{}", "(SELECT * FROM ".repeat(2_000), ") a".repeat(2_000)),
        format!("SELECT 1 {}", "UNION ALL SELECT 1 ".repeat(3_000)),
        format!("SELECT 1::{}", "INT::".repeat(10_000) + "INT"),
        format!("SELECT a{}", "[1]".repeat(20_000)),
        format!("SELECT a{}", ".a".repeat(30_000)),
        format!("{}SELECT 1", "WITH a AS (".repeat(5_000)),
        "(".repeat(65_536),
        "SELECT ".repeat(9_000),
        format!("SELECT * FROM {}", "(".repeat(60_000)),
        format!("SELECT * FROM trials {}", "JOIN trials ".repeat(5_000)),
        format!("SELECT {}", "CASE ".repeat(12_000)),
        format!("SELECT {}", "x IN (".repeat(10_000)),
    ];
    kinds.push(("deep nesting", Bounded, deep.into()));
    let texts = [
        format!("SELECT '{}'", "x".repeat(1 << 20)),
        " ".repeat(1 << 20),
        "SELECT 1 -- ".to_owned() + &"x".repeat(1 << 20),
        "\u{1f600}".repeat(1 << 18),
        "\0".repeat(1 << 20),
        format!("SELECT * FROM {}", "t".repeat(1 << 20)),
        format!("SELECT {}", long(200_000, |_| "tips".into(), ",")),
        "SELECT ".repeat(150_000),
        format!("SELECT 1{}", ";".repeat(1 << 20)),
        "(".repeat(1 << 20),
    ];
    kinds.push(("texts of 1 MB", Refused, texts.into()));
    let wide = [
        format!("SELECT {}", long(5_000, |n| format!("{n} AS c{n}"), ",")),
        format!("SELECT '{}' AS a", "x".repeat(65_000)),
        format!("SELECT 1 AS \"{}\"", "x".repeat(65_000)),
        format!(
            "SELECT tips FROM trials WHERE tips IN ({})",
            long(15_000, |n| (n % 9).to_string(), ",")
        ),
        format!("SELECT {}", long(9_000, |_| "1 AS a".into(), ",")),
        format!("SELECT {} FROM trials LIMIT 1", long(3_000, |n| format!("fvu*{n} AS c{n}"), ",")),
        format!("SELECT concat({})", long(15_000, |_| "'a'".into(), ",")),
        format!("SELECT * FROM {}", long(6, |n| format!("trials t{n}"), ",")),
        format!(
            "SELECT * FROM trials t0 {}",
            long(40, |n| format!("JOIN trials t{} USING (trial_id)", n + 1), " ")
        ),
        format!(
            "WITH a0 AS (SELECT 1 AS n) {} SELECT count(*) FROM a16",
            long(16, |n| format!(", a{} AS (SELECT a.n FROM a{n} a CROSS JOIN a{n} b)", n + 1), "")
        ),
        format!(
            "WITH a0 AS (SELECT trial_id AS n FROM trials) {} SELECT count(*) FROM a12",
            long(
                12,
                |n| format!(", a{} AS (SELECT n FROM a{n} UNION ALL SELECT n FROM a{n})", n + 1),
                ""
            )
        ),
        format!(
            "WITH a0 AS (SELECT trial_id AS n FROM trials) {} SELECT count(*) FROM a24",
            long(
                24,
                |n| format!(", a{} AS (SELECT n FROM a{n} UNION ALL SELECT n FROM a{n})", n + 1),
                ""
            )
        ),
        format!("VALUES {}", long(10_000, |n| format!("({n})"), ",")),
        format!("SELECT * FROM trials ORDER BY {}", long(5_000, |_| "fvu".into(), ",")),
        format!(
            "SELECT count(*) FROM trials GROUP BY {}",
            long(5_000, |n| format!("fvu + {n}"), ",")
        ),
    ];
    kinds.push(("wide statements", Bounded, wide.into()));
    kinds.push(kind(
        "much work",
        Bounded,
        &[
            "SELECT count(*) FROM trials a, trials b, trials c, trials d",
            "SELECT count(*) FROM trials a CROSS JOIN trials b CROSS JOIN trials c CROSS JOIN trials d",
            "SELECT * FROM trials a CROSS JOIN trials b CROSS JOIN trials c",
            "SELECT sum(a.fvu * b.fvu * c.fvu) FROM trials a, trials b, trials c, trials d WHERE a.fvu < b.fvu",
            "SELECT a.trial_id FROM trials a JOIN trials b ON a.fvu < b.fvu JOIN trials c ON b.fvu < c.fvu ORDER BY 1",
            "SELECT array_agg(a.label || b.label || c.label) FROM trials a, trials b, trials c",
            "SELECT string_agg(a.label, b.label) FROM trials a, trials b, trials c",
            "SELECT DISTINCT a.fvu * b.fvu + c.fvu AS x FROM trials a, trials b, trials c",
            "SELECT a.fvu FROM trials a, trials b, trials c ORDER BY a.fvu * b.fvu - c.fvu",
            "SELECT count(*) FROM voltages a JOIN voltages b ON a.position = b.position",
            "SELECT * FROM voltages a, voltages b ORDER BY a.voltage_v * b.voltage_v",
            "SELECT a.voltage_v, count(*) FROM voltages a, voltages b GROUP BY a.voltage_v",
            "SELECT rank() OVER (ORDER BY a.fvu * b.fvu) AS r FROM trials a, trials b, trials c",
            "SELECT sum(a.fvu) OVER (PARTITION BY b.fvu ORDER BY a.fvu) AS s FROM trials a, trials b",
            "SELECT median(a.fvu * b.fvu * c.fvu) FROM trials a, trials b, trials c",
            "SELECT lpad('a', 1000000000, 'b') AS a", "SELECT rpad('a', 4000000000, 'b') AS a",
            "SELECT lpad(label, 2000000000, 'x') AS a FROM trials",
            "SELECT repeat('x', 1000000000) AS a", "SELECT replace(lpad('a', 100000000, 'a'), 'a', 'bbbbbbbbbb') AS a",
            "SELECT array_agg(voltages_v) FROM frames a, trials b, trials c",
            "SELECT unnest(a.voltages_v) AS v FROM frames a, frames b, frames c",
            "SELECT trial_id FROM trials WHERE trial_id IN (SELECT a.trial_id FROM trials a, trials b, trials c, trials d)",
        ],
    ));
    kinds.push(kind(
        "regular expressions",
        Bounded,
        &[
            "SELECT count(*) FROM trials WHERE label ~ '^(a+)+$'", "SELECT count(*) FROM trials WHERE label ~ '(x+x+)+y'",
            "SELECT count(*) FROM trials WHERE label ~ '(((((((((a{100}){100}){100}){100}){100}){100}){100}){100}){100})'",
            "SELECT count(*) FROM trials WHERE label ~ 'a{1000000000}'", "SELECT count(*) FROM trials WHERE label ~ '\\p{L}{1000}{1000}'",
            "SELECT count(*) FROM trials WHERE regexp_like(label, '(.*)(.*)(.*)(.*)(.*)(.*)(.*)(.*)[^a]$')",
            "SELECT count(*) FROM trials WHERE label LIKE '%a%b%c%d%e%f%g%h%i%j%k%l%m%n%o%p%'",
            "SELECT count(*) FROM trials WHERE label ~ '(?:a?){1000}a{1000}'", "SELECT count(*) FROM trials WHERE label ~ '['",
            "SELECT count(*) FROM trials WHERE label ~ '(?R)'", "SELECT count(*) FROM trials WHERE label ~ '(a)\\1'",
            "SELECT columns('(a{1000}){1000}') FROM trials",
        ],
    ));
    kinds
}
