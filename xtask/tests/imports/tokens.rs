//! Rust and WESL as tokens, without comments and literals.

/// An identifier, or a single other character; `::` is one token.
pub type Token = String;

/// The tokens of a source, without text literals.
pub fn tokens(source: &str) -> Vec<Token> {
    let chars: Vec<char> = source.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let mut tokens = Vec::new();
    let mut i = 0;
    while i < chars.len() {
        let c = at(i);
        if c == '/' && at(i + 1) == '/' {
            while i < chars.len() && at(i) != '\n' {
                i += 1;
            }
        } else if c == '/' && at(i + 1) == '*' {
            let end = (i + 2..chars.len()).find(|j| at(*j) == '*' && at(j + 1) == '/');
            i = end.map_or(chars.len(), |end| end + 2);
        } else if let Some(end) = after_text(&chars, i) {
            i = end;
        } else if c.is_alphanumeric() || c == '_' {
            let start = i;
            while at(i).is_alphanumeric() || at(i) == '_' {
                i += 1;
            }
            tokens.push(chars[start..i].iter().collect());
        } else if c == ':' && at(i + 1) == ':' {
            tokens.push("::".into());
            i += 2;
        } else {
            if !c.is_whitespace() {
                tokens.push(c.into());
            }
            i += 1;
        }
    }
    tokens
}

/// The position after a text literal that begins here.
fn after_text(chars: &[char], start: usize) -> Option<usize> {
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let begins_word = start == 0 || !(at(start - 1).is_alphanumeric() || at(start - 1) == '_');
    let mut i = start;
    if begins_word && matches!(at(i), 'b' | 'c') && matches!(at(i + 1), '"' | 'r') {
        i += 1;
    }
    if begins_word && at(i) == 'r' && matches!(at(i + 1), '"' | '#') {
        let hashes = (i + 1..).take_while(|j| at(*j) == '#').count();
        if at(i + 1 + hashes) == '"' {
            let end: Vec<char> = format!("\"{}", "#".repeat(hashes)).chars().collect();
            let begin = (i + 2 + hashes..chars.len()).find(|j| chars[*j..].starts_with(&end));
            return Some(begin.unwrap_or(chars.len()) + end.len());
        }
    }
    match at(i) {
        '"' => {
            i += 1;
            while i < chars.len() && at(i) != '"' {
                i += if at(i) == '\\' { 2 } else { 1 };
            }
            Some(i + 1)
        }
        // Characters have an end, lifetimes don't.
        '\'' if at(i + 1) == '\\' => (i + 3..chars.len()).find(|j| at(*j) == '\'').map(|j| j + 1),
        '\'' if at(i + 2) == '\'' => Some(i + 3),
        _ => None,
    }
}

/// The position after the bracket that closes the one at `open`.
pub fn after_group(tokens: &[Token], open: usize) -> usize {
    let mut depth = 0;
    for (i, token) in tokens.iter().enumerate().skip(open) {
        match token.as_str() {
            "{" | "(" | "[" => depth += 1,
            "}" | ")" | "]" => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return i + 1;
        }
    }
    tokens.len()
}

/// The paths of a tree like `a::{b, c::{self, d as e}}` that begins at `start`, each with its new name, and the position after the tree.
pub fn path_tree(tokens: &[Token], start: usize) -> (Vec<(Vec<String>, String)>, usize) {
    let at = |i: usize| tokens.get(i).map_or("", String::as_str);
    let mut prefix: Vec<String> = Vec::new();
    let mut i = start;
    loop {
        if at(i) == "{" {
            let end = after_group(tokens, i);
            let mut paths = Vec::new();
            i += 1;
            while i + 1 < end {
                let (below, next) = path_tree(tokens, i);
                for (path, name) in below {
                    let below = path
                        .into_iter()
                        .filter(|segment| segment != "self" || prefix.is_empty());
                    let whole: Vec<_> = prefix.iter().cloned().chain(below).collect();
                    let is_self = name == "self" && !whole.is_empty();
                    let name = if is_self { whole[whole.len() - 1].clone() } else { name };
                    paths.push((whole, name));
                }
                i = next.max(i + 1);
                if at(i) == "," {
                    i += 1;
                }
            }
            return (paths, end);
        }
        prefix.push(at(i).to_owned());
        i += 1;
        if at(i) == "::" && (at(i + 1) == "{" || at(i + 1) == "*" || is_name(at(i + 1))) {
            i += 1;
            continue;
        }
        let mut name = prefix.last().cloned().unwrap_or_default();
        if at(i) == "as" {
            name = at(i + 1).to_owned();
            i += 2;
        }
        return (vec![(prefix, name)], i);
    }
}

/// Returns whether a token is an identifier.
pub fn is_name(token: &str) -> bool {
    token.starts_with(|c: char| c.is_alphabetic() || c == '_')
}
