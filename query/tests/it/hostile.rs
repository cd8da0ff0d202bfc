//! Statements that nobody should send: each is refused, answered, or ended, and changes nothing.
//! Uses: `common`, the built program. Never: a file or an address outside of the test.

use std::io::ErrorKind;
use std::net::TcpListener;
use std::os::unix::process::ExitStatusExt;
use std::time::Duration;

use polars::prelude::{Column, DataFrame};

use crate::common::{Bounds, Folder, Outcome, Trials, ask, tables, text};

/// Largest result, so that a longer one is refused.
const ROWS_MAX: u64 = 1000;
/// Longest time of a statement that may take any; then this test ends the program, as the service does.
const TIME_MAX: Duration = Duration::from_secs(3);
/// Longest time of another one: far more than it takes.
const PATIENCE: Duration = Duration::from_secs(60);
/// With the stack of a thread, 256 MiB.
const MEMORY_MAX_BYTES: u64 = 768 << 20;
const SIGABRT: i32 = 6;
/// Number in a file that no statement may read.
const SECRET: u64 = 271_828_182;

const GOOD: &str = "SELECT tips, count(*) AS n FROM trials GROUP BY tips ORDER BY tips";
const GOOD_ROWS: &str = "0 | 50\n1 | 50\n2 | 50\n3 | 50";

/// What must come of a statement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expected {
    /// A refusal.
    Refused,
    /// Rows, at most `ROWS_MAX`.
    Answered,
    /// Any of them, or the end of the program for lack of memory, stack or time.
    Bounded,
}

use Expected::{Answered, Bounded, Refused};

type Kind = (&'static str, Expected, Vec<String>);

fn kind(name: &'static str, expected: Expected, statements: &[&str]) -> Kind {
    (name, expected, statements.iter().map(ToString::to_string).collect())
}

fn files_and_addresses(secret: &str, address: &str) -> Kind {
    let functions = [
        "read_parquet",
        "read_csv",
        "read_csv_auto",
        "read_ipc",
        "read_json",
        "read_json_auto",
        "read_ndjson",
        "read_text",
        "read_blob",
        "parquet_scan",
        "scan_parquet",
        "scan_csv",
        "scan_ipc",
        "sniff_csv",
        "iceberg_scan",
        "delta_scan",
        "sqlite_scan",
        "postgres_scan",
        "mysql_query",
        "parquet_metadata",
        "glob",
        "url",
        "file",
        "s3",
        "READ_PARQUET",
        "\"read_parquet\"",
        "main.read_parquet",
        "pg_read_file",
        "query",
        "query_table",
    ];
    let mut statements = Vec::new();
    for function in functions {
        for path in [secret, "/etc/passwd", &format!("http://{address}/a.parquet")] {
            statements.push(format!("SELECT * FROM {function}('{path}')"));
        }
    }
    let others = [
        "SELECT * FROM '{secret}'",
        "SELECT * FROM \"{secret}\"",
        "SELECT * FROM `{secret}`",
        "SELECT * FROM 'file://{secret}'",
        "SELECT * FROM \"http://{address}/a.parquet\"",
        "SELECT * FROM 's3://bucket/a.parquet'",
        "SELECT * FROM 'hf://datasets/a/b.parquet'",
        "SELECT * FROM '{secret}' AS trials",
        "SELECT * FROM '/etc/*'",
        "SELECT * FROM '*'",
        "SELECT * FROM '../{secret}'",
        "SELECT * FROM '~/.ssh/id_rsa'",
        "SELECT * FROM 'secret.parquet'",
        "SELECT * FROM main.\"{secret}\"",
        "SELECT * FROM file.'{secret}'",
        "FROM '{secret}'",
        "SELECT * FROM trials, '{secret}'",
        "SELECT * FROM trials JOIN '{secret}' s ON true",
        "SELECT * FROM (SELECT * FROM '{secret}') a",
        "WITH a AS (SELECT * FROM '{secret}') SELECT * FROM a",
        "SELECT 1 WHERE EXISTS (SELECT * FROM '{secret}')",
        "SELECT * FROM trials WHERE trial_id IN (SELECT secret FROM read_parquet('{secret}'))",
        "SELECT * FROM trials WHERE fvu > (SELECT max(secret) FROM read_parquet('{secret}'))",
        "SELECT * FROM trials UNION ALL SELECT * FROM read_parquet('{secret}')",
        "SELECT * FROM (VALUES (1)) v, LATERAL read_parquet('{secret}')",
        "SELECT * FROM LATERAL read_csv('{secret}')",
        "SELECT * FROM TABLE(read_csv('{secret}'))",
        "SELECT * FROM TABLE('{secret}')",
        "SELECT * FROM UNNEST(read_parquet('{secret}')) AS a",
        "SELECT read_parquet('{secret}')",
        "SELECT read_text('{secret}')",
        "SELECT load_file('{secret}')",
        "SELECT pg_read_file('{secret}')",
        "SELECT * FROM OPENROWSET(BULK '{secret}', SINGLE_BLOB) AS a",
        "SELECT * FROM JSON_TABLE('{secret}', '$[*]' COLUMNS (a INT PATH '$.a')) AS a",
        "SELECT * FROM XMLTABLE('/a' PASSING '{secret}' COLUMNS a INT PATH 'a')",
        "SELECT * FROM trials PIVOT (sum(fvu) FOR tips IN (1, 2))",
        "SELECT getenv('HOME')",
        "SELECT system('id')",
        "SELECT sys_exec('id')",
        "SELECT http_get('http://{address}/')",
        "SELECT * FROM dblink('host={address}', 'SELECT 1') AS a",
        "SELECT * FROM @stage/a.csv",
        "SELECT * FROM information_schema.tables",
        "SELECT * FROM sqlite_master",
        "SELECT * FROM pg_shadow",
        "SELECT * FROM generate_series(1, 1000000000)",
        "SELECT * FROM range(1000000000)",
    ];
    let filled = |text: &str| text.replace("{secret}", secret).replace("{address}", address);
    statements.extend(others.iter().map(|other| filled(other)));
    ("files and addresses", Refused, statements)
}

fn long(times: usize, of: impl Fn(usize) -> String, separator: &str) -> String {
    (0..times).map(of).collect::<Vec<_>>().join(separator)
}

fn nested(start: &str, times: usize, end: &str) -> String {
    format!("SELECT {}1{}", start.repeat(times), end.repeat(times))
}

fn kinds(secret: &str, address: &str) -> Vec<Kind> {
    let mut kinds = vec![files_and_addresses(secret, address)];
    kinds.push(kind(
        "several statements",
        Refused,
        &[
            "SELECT 1; SELECT 2",
            "SELECT 1; DROP TABLE trials",
            "; SELECT 1; SELECT 2; ;",
            "",
            ";",
            "   ",
            "-- nothing",
            "/* nothing */",
            "SELECT 1;;DELETE FROM trials",
            "SELECT 1 /* ; */; TRUNCATE trials",
            "BEGIN; SELECT 1; COMMIT",
            "BEGIN",
            "COMMIT",
            "EXPLAIN SELECT * FROM trials",
            "EXPLAIN ANALYZE SELECT * FROM trials",
            "SHOW TABLES",
            "DESCRIBE trials",
            "SET memory_limit = '100GB'",
            "PRAGMA database_list",
            "PREPARE a AS SELECT 1",
            "EXECUTE a",
            "DECLARE a CURSOR FOR SELECT 1",
            "CALL a()",
            "DO 1",
            "LOAD 'httpfs'",
            "INSTALL httpfs",
            "USE other",
            "KILL 1",
            "VACUUM",
            "ANALYZE trials",
            "GRANT ALL ON trials TO a",
            "LISTEN a",
            "NOTIFY a",
            "LOCK TABLES trials READ",
        ],
    ));
    kinds.push(kind(
        "writes",
        Refused,
        &[
            "INSERT INTO trials VALUES (1)",
            "INSERT INTO trials SELECT * FROM trials",
            "REPLACE INTO trials VALUES (1)",
            "UPDATE trials SET tips = 0",
            "DELETE FROM trials",
            "TRUNCATE TABLE trials",
            "TRUNCATE trials",
            "DROP TABLE trials",
            "DROP TABLE IF EXISTS a",
            "DROP SCHEMA a",
            "ALTER TABLE trials DROP COLUMN tips",
            "CREATE TABLE a (b INT)",
            "CREATE TABLE a AS SELECT * FROM trials",
            "CREATE OR REPLACE TABLE trials AS SELECT 1",
            "CREATE TEMP TABLE a AS SELECT 1",
            "CREATE VIEW a AS SELECT * FROM trials",
            "CREATE INDEX a ON trials (tips)",
            "CREATE FUNCTION a() RETURNS INT AS 'SELECT 1'",
            "CREATE EXTERNAL TABLE a LOCATION '/tmp/a'",
            "CREATE SECRET a (TYPE S3)",
            "COPY trials TO '/tmp/a.parquet'",
            "COPY (SELECT * FROM trials) TO '/tmp/a.csv'",
            "COPY trials FROM '/etc/passwd'",
            "EXPORT DATABASE '/tmp/a'",
            "ATTACH DATABASE '/tmp/a' AS b",
            "SELECT * INTO a FROM trials",
            "SELECT * INTO OUTFILE '/tmp/a' FROM trials",
            "SELECT * FROM trials INTO OUTFILE '/tmp/a'",
            "SELECT * INTO DUMPFILE '/tmp/a' FROM trials",
            "WITH a AS (DELETE FROM trials RETURNING *) SELECT * FROM a",
            "WITH a AS (INSERT INTO trials VALUES (1) RETURNING *) SELECT * FROM a",
            "WITH a AS (SELECT 1) DELETE FROM trials",
            "WITH a AS (SELECT 1) INSERT INTO trials SELECT * FROM a",
            "SELECT * FROM trials FOR UPDATE",
            "SELECT * FROM trials FOR SHARE",
            "SELECT * FROM (DELETE FROM trials RETURNING *) a",
            "UNLOAD (SELECT 1) TO '/tmp/a'",
            "MERGE INTO trials USING contacts ON true WHEN MATCHED THEN DELETE",
            "SELECT * FROM (SELECT * INTO a FROM trials) b",
            "SELECT 1 UNION SELECT * INTO a FROM trials",
        ],
    ));
    kinds.push(kind(
        "recursion",
        Refused,
        &[
            "WITH RECURSIVE a AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM a) SELECT * FROM a",
            "WITH RECURSIVE a(n) AS (VALUES (1) UNION ALL SELECT n FROM a) SELECT count(*) FROM a",
            "WITH a AS (SELECT * FROM a) SELECT * FROM a",
            "WITH a AS (SELECT * FROM b), b AS (SELECT * FROM a) SELECT * FROM a",
            "WITH a AS (WITH RECURSIVE b AS (SELECT 1 UNION SELECT * FROM b) SELECT * FROM b) SELECT * FROM a",
            "SELECT * FROM (WITH RECURSIVE a AS (SELECT 1 UNION SELECT * FROM a) SELECT * FROM a) b",
        ],
    ));
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
    kinds.push(kind(
        "ends of ranges",
        Bounded,
        &[
            "SELECT 9223372036854775807 + 1 AS a", "SELECT -9223372036854775808 - 1 AS a", "SELECT 9223372036854775808 AS a",
            "SELECT 99999999999999999999999999999999999999999999 AS a", "SELECT 1e308 * 10 AS a", "SELECT 1e400 AS a",
            "SELECT 1 / 0 AS a", "SELECT 1 // 0 AS a", "SELECT 1 % 0 AS a", "SELECT tips / (tips - tips) AS a FROM trials LIMIT 1",
            "SELECT trial_id % 0 AS a FROM trials LIMIT 1", "SELECT div(trial_id, 0) AS a FROM trials LIMIT 1",
            "SELECT mod(trial_id, tips - tips) AS a FROM trials LIMIT 1", "SELECT sqrt(-1) AS a", "SELECT ln(0) AS a", "SELECT ln(-1) AS a",
            "SELECT power(10, 400) AS a", "SELECT power(2, 63) AS a", "SELECT power(0, -1) AS a", "SELECT abs(-9223372036854775808) AS a",
            "SELECT CAST(1e30 AS BIGINT) AS a", "SELECT CAST(300 AS TINYINT) AS a", "SELECT CAST(-1 AS INT UNSIGNED) AS a",
            "SELECT CAST('NaN' AS DOUBLE) AS a", "SELECT CAST('1e999' AS DOUBLE) AS a", "SELECT round(1.5, 400) AS a",
            "SELECT round(fvu, 4294967295) AS a FROM trials LIMIT 1", "SELECT round(fvu, -1) AS a FROM trials LIMIT 1",
            "SELECT tips - 5 AS a FROM trials LIMIT 1", "SELECT -tips AS a FROM trials LIMIT 2", "SELECT sum(tips) * 9223372036854775807 AS a FROM trials",
            "SELECT max_force_n * 1e300 AS a FROM trials LIMIT 1", "SELECT substr(label, 9223372036854775807) AS a FROM trials LIMIT 1",
            "SELECT substr(label, -9223372036854775808, 9223372036854775807) AS a FROM trials LIMIT 1",
            "SELECT left(label, -9223372036854775808) AS a FROM trials LIMIT 1", "SELECT right(label, 9223372036854775807) AS a FROM trials LIMIT 1",
            "SELECT voltages_v[9223372036854775807] AS a FROM frames LIMIT 1", "SELECT voltages_v[-9223372036854775808] AS a FROM frames LIMIT 1",
            "SELECT array_get(voltages_v, 99999999999) AS a FROM frames LIMIT 1", "SELECT lag(tips, 9223372036854775807) OVER (ORDER BY trial_id) AS a FROM trials LIMIT 1",
            "SELECT quantile_cont(fvu, 1e300) AS a FROM trials", "SELECT quantile_disc(fvu, -1) AS a FROM trials",
            "SELECT measured_at + INTERVAL '999999999999 days' AS a FROM trials LIMIT 1", "SELECT INTERVAL '99999999999999999999 years' AS a",
            "SELECT DATE '99999-12-31' AS a", "SELECT TIMESTAMP '-999999-01-01 00:00:00' AS a", "SELECT DATE '2027-02-30' AS a",
            "SELECT CAST(9223372036854775807 AS TIMESTAMP) AS a", "SELECT strftime(measured_at, '%') AS a FROM trials LIMIT 1",
            "SELECT strftime(measured_at, '%Q%%%1000000d') AS a FROM trials LIMIT 1", "SELECT strptime('x', '%') AS a",
            "SELECT x'00' AS a", "SELECT b'2' AS a", "SELECT 0x7fffffffffffffffff AS a", "SELECT 1_000 AS a", "SELECT .e1 AS a",
        ],
    ));
    kinds.push(kind(
        "limits",
        Bounded,
        &[
            "SELECT trial_id FROM trials LIMIT 18446744073709551615",
            "SELECT trial_id FROM trials LIMIT 99999999999999999999999",
            "SELECT trial_id FROM trials OFFSET 9223372036854775807",
            "SELECT trial_id FROM trials LIMIT 9223372036854775807 OFFSET 9223372036854775807",
            "SELECT trial_id FROM trials LIMIT -1",
            "SELECT trial_id FROM trials LIMIT 1e3",
            "SELECT trial_id FROM trials LIMIT NULL",
            "SELECT trial_id FROM trials LIMIT (SELECT 1)",
            "SELECT trial_id FROM trials LIMIT ALL",
            "SELECT trial_id FROM trials FETCH FIRST 50 PERCENT ROWS ONLY",
            "SELECT trial_id FROM trials ORDER BY 999999999",
            "SELECT trial_id FROM trials GROUP BY -1",
            "SELECT trial_id FROM trials ORDER BY fvu LIMIT 4294967296",
        ],
    ));
    kinds.push(kind(
        "windows and UNNEST",
        Bounded,
        &[
            "SELECT unnest(1) AS a", "SELECT unnest(NULL) AS a", "SELECT unnest([]) AS a", "SELECT unnest(unnest(voltages_v)) AS a FROM frames",
            "SELECT unnest(voltages_v) AS a, unnest(sim_voltages_v) AS b FROM frames", "SELECT unnest(tips) AS a FROM trials",
            "SELECT * FROM UNNEST([1, 2], ['a']) AS t (a, b)", "SELECT * FROM UNNEST([1, 2])", "SELECT * FROM UNNEST(trials) AS a",
            "SELECT trial_id, unnest(voltages_v) AS a, unnest([1, 2]) AS b FROM frames LIMIT 5", "SELECT * FROM trials, UNNEST(contacts) AS c LIMIT 5",
            "SELECT sum(unnest(voltages_v)) AS a FROM frames", "SELECT tips FROM trials WHERE unnest(contacts) IS NULL",
            "SELECT row_number() OVER () AS a FROM trials LIMIT 3", "SELECT row_number() OVER (ORDER BY row_number() OVER ()) AS a FROM trials LIMIT 3",
            "SELECT sum(sum(fvu)) OVER () AS a FROM trials", "SELECT sum(fvu) OVER (PARTITION BY sum(fvu) OVER ()) AS a FROM trials LIMIT 3",
            "SELECT lag(fvu, -1) OVER (ORDER BY trial_id) AS a FROM trials LIMIT 1", "SELECT rank() OVER w AS a FROM trials",
            "SELECT rank() OVER w AS a FROM trials WINDOW w AS (w)", "SELECT count(*) OVER (ROWS BETWEEN UNBOUNDED PRECEDING AND UNBOUNDED FOLLOWING) AS a FROM trials LIMIT 1",
            "SELECT avg(avg(fvu)) AS a FROM trials", "SELECT max(count(*)) AS a FROM trials",
        ],
    ));
    kinds.push(kind(
        "odd names that are answered",
        Answered,
        &[
            "SELECT 1 AS \"a\"\"b\"",
            "SELECT 1 AS \"; DROP TABLE trials; --\"",
            "SELECT 1 AS \"\u{1f600}\"",
            "SELECT 'it''s' AS a",
            "SELECT '\u{202e}evil\u{0}' AS a",
            "SELECT 1 AS \"SELECT\"",
            "SELECT /* ; DROP TABLE trials */ 1 AS a -- ; DROP",
            "SELECT 1 AS a;",
            "SELECT '; DROP TABLE trials' AS a",
            "select TIPS as a from (select tips as \"TIPS\" from trials) as b limit 1",
            "SELECT trial_id FROM \"run-3\" LIMIT 1",
            "SELECT r.trial_id FROM \"run-3\" AS r LIMIT 1",
            "SELECT \"run-3\".trial_id FROM \"run-3\" LIMIT 1",
            "WITH a AS (SELECT 1 AS n) SELECT n FROM a",
            "WITH \"contacts\" AS (SELECT 1 AS n) SELECT n FROM contacts",
            "WITH \"run-3\" AS (SELECT 7 AS n) SELECT n FROM \"run-3\"",
            "WITH a AS (SELECT 1 AS n), b AS (SELECT n + 1 AS n FROM a) SELECT n FROM b",
            "SELECT fvu FROM trials WHERE label = '\u{0}' LIMIT 1",
            "SELECT upper('stra\u{df}e') AS a",
            "SELECT length('\u{1f600}') AS a",
            "SELECT 'a' LIKE '%' AS a",
            "SELECT '\u{fffd}\u{feff}' AS a",
            "SELECT reverse('e\u{301}a') AS a",
            "SELECT tips FROM trials WHERE label LIKE '%\\%' LIMIT 1",
            "SELECT * FROM trials AS \"trials\" LIMIT 1",
            "SELECT NULL AS a",
            "SELECT true AND NULL AS a",
            "FROM trials LIMIT 1",
            "VALUES (1, 'a')",
        ],
    ));
    kinds.push(kind(
        "odd names that are refused",
        Refused,
        &[
            "SELECT * FROM \"trials; DROP TABLE trials\"",
            "SELECT * FROM \"\"",
            "SELECT * FROM \"\u{0}\"",
            "SELECT * FROM tri\u{200b}als",
            "SELECT * FROM \u{442}rials",
            "SELECT * FROM trials\u{0}",
            "\u{feff}SELECT 1",
            "SELECT * FROM \"TRIALS\"",
            "SELECT * FROM main.trials",
            "SELECT * FROM a.b.c.trials",
            "SELECT \u{0} FROM trials",
            "SELECT 'unclosed",
            "SELECT \"unclosed",
            "SELECT /* unclosed",
            "SELECT $1",
            "SELECT ?",
            "SELECT :a",
            "SELECT @@version",
            "SELECT {fn now()}",
            "SELECT * FROM trials AS contacts, contacts AS trials",
            "SELECT * FROM (SELECT 1 AS n) AS trials, trials AS t",
            "WITH a AS (SELECT 1 AS n) SELECT * FROM (SELECT 2 AS n) AS a, a AS b",
            "WITH a AS (SELECT 1 AS n), a AS (SELECT 2 AS n) SELECT * FROM a",
            "WITH trials AS (SELECT * FROM trials) SELECT * FROM trials",
            "SELECT * FROM trials |> WHERE tips = 1",
            "SELECT * FROM trials FOR SYSTEM_TIME AS OF '2020-01-01'",
            "SELECT * FROM trials TABLESAMPLE SYSTEM (10)",
            "SELECT * FROM trials MATCH_RECOGNIZE (PATTERN (a) DEFINE a AS true)",
            "SELECT * FROM trials CONNECT BY PRIOR tips = tips",
            "SELECT * FROM trials WITH (NOLOCK)",
            "SELECT * FROM trials SETTINGS max_threads = 100",
            "SELECT * FROM trials FORMAT JSON",
        ],
    ));
    kinds
}

/// Why an outcome is not the expected one.
fn wrong(expected: Expected, outcome: &Outcome) -> Option<String> {
    let shown = || format!("{outcome:?}").chars().take(300).collect::<String>();
    let clean = |words: &str| {
        let debug = words.contains("Span(") || words.contains("Ident") || words.contains('\n');
        words.starts_with("sql: ") && words.chars().count() <= 300 && !debug
    };
    let fine = match outcome {
        Outcome::Refused(words) if !clean(words) => return Some(format!("unclear: {}", shown())),
        Outcome::Refused(_) => expected != Answered,
        Outcome::Rows(rows) => {
            let is_plain =
                |column: &Column| column.dtype().is_integer() || column.dtype().is_string();
            let plain = rows.columns().iter().filter(|column| is_plain(column)).cloned();
            let plain = DataFrame::new(rows.height(), plain.collect()).unwrap();
            let secret = text(&plain).contains(&SECRET.to_string());
            expected != Refused && rows.height() as u64 <= ROWS_MAX && !secret
        }
        Outcome::Ended(status, said) => {
            // As the service knows them.
            let memory = ["memory allocation", "failed to initiate panic"];
            let memory = memory.iter().any(|words| said.contains(words));
            let stack = said.contains("overflowed its stack");
            expected == Bounded && status.signal() == Some(SIGABRT) && (memory || stack)
        }
        Outcome::Killed => expected == Bounded,
    };
    (!fine).then(shown)
}

#[test]
fn hostile_statements_are_refused_or_bounded_and_change_nothing() {
    let folder = Folder::new("hostile");
    let [path, secret] = ["trials.parquet", "secret.parquet"].map(|name| folder.file(name));
    Trials { first: 0, count: 200, channels: 784, without_twin: 10 }.write(&path);
    Trials { first: SECRET, count: 1, channels: 0, without_twin: 10 }.write(&secret);
    let before = std::fs::read(&path).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let known = tables(std::slice::from_ref(&path), "run-3");
    let bounds =
        Bounds { rows_max: ROWS_MAX, memory_max_bytes: MEMORY_MAX_BYTES, time_max: PATIENCE };

    let kinds = kinds(&secret.display().to_string(), &address);
    let count: usize = kinds.iter().map(|(_, _, statements)| statements.len()).sum();
    assert!(count >= 400, "{count} statements");
    let mut failures = Vec::new();
    for (name, expected, statements) in &kinds {
        let mut sums = [0; 5];
        for sql in statements {
            let time_max = if *expected == Bounded { TIME_MAX } else { PATIENCE };
            let outcome = ask(sql, &known, Bounds { time_max, ..bounds });
            sums[match &outcome {
                Outcome::Refused(_) => 0,
                Outcome::Rows(_) => 1,
                Outcome::Ended(_, said) if said.contains("overflowed its stack") => 3,
                Outcome::Ended(..) => 2,
                Outcome::Killed => 4,
            }] += 1;
            if let Some(found) = wrong(*expected, &outcome) {
                let start: String = sql.chars().take(150).collect();
                failures.push(format!("{name}: {start}: {expected:?}, but {found}"));
            }
        }
        let [refused, answered, memory, stack, killed] = sums;
        println!(
            "{name}: {} statements: {refused} refused, {answered} answered, {memory} out of memory, \
             {stack} out of stack, {killed} out of time",
            statements.len()
        );
        assert_eq!(text(&ask(GOOD, &known, bounds).rows()), GOOD_ROWS, "after {name}");
    }
    assert!(failures.is_empty(), "{} of {count}:\n{}", failures.len(), failures.join("\n"));
    assert_eq!(listener.accept().unwrap_err().kind(), ErrorKind::WouldBlock, "a connection");
    assert!(std::fs::read(&path).unwrap() == before, "the file has changed");
}
