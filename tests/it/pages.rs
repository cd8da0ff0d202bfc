//! The table of pages in the document of the dashboard follows from `web/pages.js`; `UPDATE=1` writes it.
//! Uses: the two files. Never: a browser, another part of the document.

use std::fs;
use std::path::Path;

const TABLE_HEAD: &str = "| page | question | what is there |\n|---|---|---|\n";

/// A text of a row of `web/pages.js`, which begins with the name of the page.
fn text<'a>(row: &'a str, key: &str) -> &'a str {
    let found = row.split_once(&format!("{key}: '")).and_then(|(_, rest)| rest.split_once('\''));
    found.unwrap_or_else(|| panic!("no {key}: {row}")).0
}

#[test]
fn the_document_of_the_dashboard_lists_its_pages() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let pages = fs::read_to_string(root.join("web/pages.js")).unwrap();
    let path = root.join("docs/how-to/dashboard.md");
    let document = fs::read_to_string(&path).unwrap();
    let mut table = String::new();
    for row in pages.split("{ name: '").skip(1) {
        let module = format!("web/pages/{}.js", row.split('\'').next().unwrap());
        assert!(root.join(&module).is_file(), "{module} is missing");
        let cells = ["title", "about", "shows"].map(|key| text(row, key));
        table += &format!("| {} |\n", cells.join(" | "));
    }
    assert!(!table.is_empty(), "web/pages.js has rows");
    let (before, rest) = document.split_once(TABLE_HEAD).expect("the document has the table");
    let (_, after) = rest.split_once("\n\n").expect("text follows the table");
    let written = format!("{before}{TABLE_HEAD}{table}\n{after}");
    if std::env::var_os("UPDATE").is_some() {
        fs::write(&path, &written).unwrap();
    } else {
        assert!(
            document == written,
            "docs/how-to/dashboard.md is old: UPDATE=1 rewrites its table"
        );
    }
}
