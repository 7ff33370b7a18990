//! Refuses circles between the modules of a crate.
//!
//! Every path that begins with `crate`, `super`, `self` or a module's own child counts, in `use` and in
//! expressions; comments and code under `#[cfg(test)]` do not. A name that a module hands on with `pub use`
//! counts for the module that defines it. At every level the children of a module, each with all that lies
//! below it, and the module's own code must have an order in which each uses only what stands before it.
//! Two things are no use: `mod child;`, and a `pub use` of what lies below. A module inside a file is part of
//! that file.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use proc_macro2::{Delimiter, TokenStream, TokenTree};

/// Names from the root of the crate, which is the empty path.
type Name = Vec<String>;

/// A path that is written in the code, `*` at its end for everything.
struct Use {
    path: Name,
    /// The name under which others see it, where it is handed on.
    public: Option<String>,
}

#[derive(Default)]
struct Module {
    /// Written inside its parent's file.
    inline: bool,
    children: BTreeSet<String>,
    items: BTreeSet<String>,
    uses: Vec<Use>,
}

/// All modules of a crate.
#[derive(Default)]
struct Crate(BTreeMap<Name, Module>);

impl Crate {
    fn read(root: &Path) -> Self {
        let mut modules = Self::default();
        modules.file(root, root.parent().expect("a folder"), &Vec::new());
        modules
    }

    /// Reads the module `name` from `file`; files of its children lie in `below`.
    fn file(&mut self, file: &Path, below: &Path, name: &Name) {
        let text =
            std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let tokens: TokenStream = text
            .parse()
            .unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        self.0.entry(name.clone()).or_default();
        self.tokens(tokens, below, name, true);
    }

    /// `top`: directly in the module, not in a body.
    fn tokens(&mut self, tokens: TokenStream, below: &Path, name: &Name, top: bool) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let word = |at: usize| match tokens.get(at) {
            Some(TokenTree::Ident(ident)) => Some(ident.to_string()),
            _ => None,
        };
        let sign = |at: usize, sign: char| matches!(tokens.get(at), Some(TokenTree::Punct(punct)) if punct.as_char() == sign);
        let joint = |at: usize| sign(at, ':') && sign(at + 1, ':');
        let mut public = false;
        let mut at = 0;
        while at < tokens.len() {
            if sign(at, '#') {
                let Some(TokenTree::Group(attribute)) = tokens.get(at + 1) else {
                    // The attribute of a whole file: `#![...]`.
                    at += 3;
                    continue;
                };
                at += 2;
                if is_test(attribute.stream()) {
                    while at < tokens.len() && !sign(at, ';') && !is_block(&tokens[at]) {
                        at += 1;
                    }
                    at += 1;
                }
                continue;
            }
            if let TokenTree::Group(group) = &tokens[at] {
                self.tokens(group.stream(), below, name, false);
                at += 1;
                continue;
            }
            let Some(first) = word(at) else {
                public = false;
                at += 1;
                continue;
            };
            match first.as_str() {
                "pub" => {
                    public = true;
                    at += 1 + usize::from(matches!(
                        tokens.get(at + 1),
                        Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Parenthesis
                    ));
                    continue;
                }
                "use" => {
                    let end = (at..tokens.len())
                        .find(|&end| sign(end, ';'))
                        .unwrap_or(tokens.len());
                    let tree = tokens[at + 1..end].iter().cloned().collect();
                    let mut uses = Vec::new();
                    spread(tree, &Vec::new(), public, &mut uses);
                    self.0.get_mut(name).expect("read").uses.append(&mut uses);
                    at = end;
                }
                "mod" if word(at + 1).is_some() => {
                    let child = word(at + 1).expect("a name");
                    let inner = [&name[..], std::slice::from_ref(&child)].concat();
                    let folder = below.join(&child);
                    self.0
                        .get_mut(name)
                        .expect("read")
                        .children
                        .insert(child.clone());
                    self.0.entry(inner.clone()).or_default();
                    if let Some(TokenTree::Group(body)) = tokens.get(at + 2) {
                        self.0.get_mut(&inner).expect("read").inline = true;
                        self.tokens(body.stream(), &folder, &inner, true);
                    } else {
                        let beside = below.join(child + ".rs");
                        let file = if beside.exists() {
                            beside
                        } else {
                            folder.join("mod.rs")
                        };
                        self.file(&file, &folder, &inner);
                    }
                    at += 2;
                }
                "fn" | "struct" | "enum" | "trait" | "const" | "static" | "type" if top => {
                    if let Some(item) = word(at + 1) {
                        self.0.get_mut(name).expect("read").items.insert(item);
                    }
                }
                _ if joint(at + 1) && !(at >= 2 && joint(at - 2)) => {
                    let mut path = vec![first];
                    while joint(at + 1) && word(at + 3).is_some() {
                        path.extend(word(at + 3));
                        at += 3;
                    }
                    let found = Use { path, public: None };
                    self.0.get_mut(name).expect("read").uses.push(found);
                }
                _ => {}
            }
            public = false;
            at += 1;
        }
    }

    /// The module in which lies what `path` names when it is written in `from`; `None` outside the crate.
    fn resolve(&self, from: &Name, path: &[String], depth: usize) -> Option<Name> {
        let mut module = match path.first()?.as_str() {
            "crate" => Name::new(),
            "self" | "super" => from.clone(),
            child if self.0[from].children.contains(child) => from.clone(),
            _ => return None,
        };
        for (at, part) in path.iter().enumerate() {
            let here = &self.0[&module];
            match part.as_str() {
                "crate" | "self" if at == 0 => {}
                "self" | "*" => {}
                "super" => drop(module.pop()),
                child if here.children.contains(child) => module.push(part.clone()),
                item if here.items.contains(item) || depth > 8 => return Some(module),
                item => {
                    let handed_on = here.uses.iter().filter_map(|other| {
                        let everything = other.public.as_deref() == Some("*");
                        let mut path = other.path.clone();
                        if everything {
                            *path.last_mut()? = item.to_owned();
                        }
                        let home = self.resolve(&module, &path, depth + 1)?;
                        let fits = if everything {
                            self.0[&home].items.contains(item)
                        } else {
                            other.public.as_deref() == Some(item)
                        };
                        fits.then_some(home)
                    });
                    return handed_on.into_iter().next().or(Some(module));
                }
            }
        }
        Some(module)
    }

    /// For every module with children: who uses whom among them and the module's own code (the empty
    /// name), each with one path that shows it.
    fn levels(&self) -> BTreeMap<Name, BTreeMap<(String, String), String>> {
        let file = |mut name: Name| {
            while self.0[&name].inline {
                name.pop();
            }
            name
        };
        let mut levels = BTreeMap::<Name, BTreeMap<(String, String), String>>::new();
        for (module, contents) in &self.0 {
            let from = &file(module.clone());
            for used in &contents.uses {
                let Some(to) = self.resolve(module, &used.path, 0).map(file) else {
                    continue;
                };
                let handed_on = used.public.is_some() && to.starts_with(from);
                if to == *from || handed_on {
                    continue;
                }
                let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
                let node = |name: &Name| name.get(common).cloned().unwrap_or_default();
                levels
                    .entry(from[..common].to_vec())
                    .or_default()
                    .entry((node(from), node(&to)))
                    .or_insert_with(|| format!("{}: {}", from.join("::"), used.path.join("::")));
            }
        }
        levels
    }

    /// One line for every circle's worth of modules that can reach each other, with its evidence.
    fn circles(&self) -> Vec<String> {
        let mut circles = Vec::new();
        for (level, edges) in self.levels() {
            let mut reached: BTreeSet<(String, String)> = edges.keys().cloned().collect();
            loop {
                let further: BTreeSet<(String, String)> = reached
                    .iter()
                    .flat_map(|(a, b)| {
                        let from_b = edges.keys().filter(move |(from, _)| from == b);
                        from_b.map(move |(_, c)| (a.clone(), c.clone()))
                    })
                    .filter(|pair| !reached.contains(pair))
                    .collect();
                if further.is_empty() {
                    break;
                }
                reached.extend(further);
            }
            let both = |a: &String, b: &String| {
                reached.contains(&(a.clone(), b.clone()))
                    && reached.contains(&(b.clone(), a.clone()))
            };
            let mut told = BTreeSet::new();
            for (a, _) in edges.keys().filter(|(a, b)| both(a, b)) {
                if told.contains(a) {
                    continue;
                }
                let circle: Vec<&(String, String)> = edges
                    .keys()
                    .filter(|(b, c)| both(a, b) && both(a, c))
                    .collect();
                told.extend(circle.iter().map(|(from, _)| from.clone()));
                let mut line = format!("in `{}`:", level.join("::"));
                for edge in circle {
                    let own = |name: &str| {
                        if name.is_empty() {
                            "(own code)".to_owned()
                        } else {
                            name.to_owned()
                        }
                    };
                    let _ = write!(
                        line,
                        "\n    {} -> {}   {}",
                        own(&edge.0),
                        own(&edge.1),
                        edges[edge]
                    );
                }
                circles.push(line);
            }
        }
        circles
    }
}

/// `cfg(test)`, `cfg(all(test, ..))` and `test` itself.
fn is_test(attribute: TokenStream) -> bool {
    let text = attribute.to_string();
    let words: BTreeSet<&str> = text
        .split(|c: char| !c.is_alphanumeric() && c != '_')
        .collect();
    text == "test" || words.contains("cfg") && words.contains("test") && !words.contains("not")
}

fn is_block(token: &TokenTree) -> bool {
    matches!(token, TokenTree::Group(group) if group.delimiter() == Delimiter::Brace)
}

/// The single paths of the tree of a `use`, each after `before`.
fn spread(tree: TokenStream, before: &Name, public: bool, uses: &mut Vec<Use>) {
    let mut path = before.clone();
    let mut renamed = None;
    for token in tree.into_iter().map(Some).chain([None]) {
        match token {
            Some(TokenTree::Ident(word)) if word == "as" => renamed = Some(String::new()),
            Some(TokenTree::Ident(word)) => match &mut renamed {
                Some(name) => *name = word.to_string(),
                None => path.push(word.to_string()),
            },
            Some(TokenTree::Punct(star)) if star.as_char() == '*' => path.push("*".to_owned()),
            Some(TokenTree::Group(group)) => {
                spread(group.stream(), &path, public, uses);
                path.clone_from(before);
            }
            Some(TokenTree::Punct(colon)) if colon.as_char() == ':' => {}
            // A comma or the end.
            _ => {
                if path.len() > before.len() {
                    let last = path.iter().rfind(|part| *part != "self").cloned();
                    let public = renamed.take().or(last).filter(|_| public);
                    uses.push(Use {
                        path: std::mem::replace(&mut path, before.clone()),
                        public,
                    });
                }
                renamed = None;
            }
        }
    }
}

#[test]
fn modules_of_a_crate_form_no_circle() {
    let top = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut circles = String::new();
    for member in [
        "splits",
        "prep",
        "prep/geometry",
        "prep/store",
        "train",
        "train/onnx",
        "bench",
        "bench/leaderboard",
        "bench/metrics",
        "tests",
        "tests/needs",
    ] {
        for circle in Crate::read(&top.join(member).join("src/lib.rs")).circles() {
            let _ = writeln!(circles, "{member}, {circle}");
        }
    }
    assert!(
        circles.is_empty(),
        "modules use each other in a circle:\n{circles}"
    );
}

/// A crate of the given files, `name.rs` or `name/mod.rs`, and the circles that are found in it.
fn circles(files: &[(&str, &str)]) -> Vec<String> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, text) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        std::fs::write(path, text).expect("a file");
    }
    Crate::read(&folder.path().join("lib.rs")).circles()
}

#[test]
fn circles_are_seen() {
    let lib = ("lib.rs", "pub mod a; mod b; mod c;");
    for (b, c) in [
        ("use crate::c::C;", "fn c() { crate::b::b() } struct C;"),
        (
            "use super::{a, c::{self, C}};",
            "pub struct C; mod d { use crate::b; }",
        ),
        (
            "fn b() { if true { use super::c; } }",
            "const C: u8 = super::b::B; ",
        ),
        (
            "fn b() { format!(\"{}\", crate::c::C) }",
            "pub use crate::b::B;",
        ),
        // Through a name that somebody else hands on.
        (
            "pub struct B; use crate::a::Handed;",
            "pub struct C; use crate::b::B;",
        ),
        (
            "pub struct B; use crate::a::Other;",
            "pub struct Other; use crate::b::B;",
        ),
    ] {
        let a = (
            "a.rs",
            "pub use crate::c::C as Handed; pub use crate::c::*;",
        );
        let found = circles(&[lib, a, ("b.rs", b), ("c/mod.rs", c)]);
        assert_eq!(found.len(), 1, "{b} {c}: {found:?}");
        assert!(
            found[0].contains("b -> c") && found[0].contains("c -> b"),
            "{found:?}"
        );
    }
    let three = [
        lib,
        ("a.rs", "use crate::b::x;"),
        ("b.rs", "use crate::c::x;"),
        ("c.rs", "use crate::a::x;"),
    ];
    assert_eq!(circles(&three).len(), 1);
    let parent = [
        ("lib.rs", "mod a; pub struct Own; fn f() { a::g() }"),
        ("a.rs", "use crate::Own; pub fn g() {}"),
    ];
    assert_eq!(circles(&parent).len(), 1);
    let cousins = [
        ("lib.rs", "mod a; mod b;"),
        ("a/mod.rs", "pub mod x; pub mod y;"),
        ("a/x.rs", "use crate::b;"),
        ("a/y.rs", ""),
        ("b.rs", "use crate::a::y;"),
    ];
    assert_eq!(
        circles(&cousins).len(),
        1,
        "the rooms a and b use each other"
    );
}

#[test]
fn what_is_no_circle_is_not_seen() {
    let lib = (
        "lib.rs",
        "pub mod a; mod b; pub use a::A; pub use crate::b::{B, b as c};",
    );
    for (a, b) in [
        (
            "use crate::b::B; pub struct A;",
            "// use crate::a::A;\n/// [`crate::a::A`]\npub struct B;",
        ),
        (
            "use crate::b::B; pub struct A;",
            "#[cfg(test)] mod tests { use crate::a::A; }",
        ),
        (
            "use crate::b::B; pub struct A;",
            "#[cfg(test)] fn f() { crate::a::A; } pub struct B;",
        ),
        (
            "use crate::b::B; pub struct A;",
            "const TEXT: &str = \"crate::a::A\";",
        ),
        (
            "use crate::{B, c}; pub struct A;",
            "pub struct B; pub fn b() {}",
        ),
        (
            "pub mod inner { pub use super::A; } struct A; use inner::A as Z;",
            "use std::a::A; struct B;",
        ),
    ] {
        let found = circles(&[lib, ("a.rs", a), ("b.rs", b)]);
        assert!(found.is_empty(), "{a} {b}: {found:?}");
    }
}
