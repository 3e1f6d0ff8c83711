//! Rust source as words and signs, without comments, string literals and test code.

/// A word or a sign, and its line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Token {
    /// A word, `::`, or a single sign.
    pub(super) text: String,
    /// Line, the first is 1.
    pub(super) line: usize,
}

impl Token {
    /// Whether this is a name or a keyword.
    pub(super) fn is_word(&self) -> bool {
        self.text
            .starts_with(|first: char| first.is_alphabetic() || first == '_')
    }
}

/// The tokens of a text, without string literals, characters and numbers.
pub(super) fn tokens(text: &str) -> Vec<Token> {
    let letters: Vec<char> = text.chars().collect();
    let at = |index: usize| letters.get(index).copied().unwrap_or('\0');
    let (mut tokens, mut line, mut index) = (Vec::new(), 1, 0);
    while index < letters.len() {
        let begun = index;
        let letter = at(index);
        match letter {
            '/' if at(index + 1) == '/' => index = end_of_line(&letters, index),
            '/' if at(index + 1) == '*' => index = end_of_comment(&letters, index),
            '"' => index = end_of_text(&letters, index),
            '\'' => index = end_of_quote(&letters, index),
            'r' | 'b' | 'c' if is_raw(&letters, index).is_some() => {
                index = is_raw(&letters, index).unwrap_or(index + 1);
            }
            'b' | 'c' if at(index + 1) == '"' => index = end_of_text(&letters, index + 1),
            'b' if at(index + 1) == '\'' => index = end_of_quote(&letters, index + 1),
            _ if letter.is_alphanumeric() || letter == '_' => {
                while at(index).is_alphanumeric() || at(index) == '_' {
                    index += 1;
                }
                let word: String = letters.get(begun..index).unwrap_or_default().iter().collect();
                if !letter.is_numeric() {
                    tokens.push(Token { text: word, line });
                }
            }
            ':' if at(index + 1) == ':' => {
                tokens.push(Token {
                    text: "::".into(),
                    line,
                });
                index += 2;
            }
            _ => {
                if !letter.is_whitespace() {
                    tokens.push(Token {
                        text: letter.into(),
                        line,
                    });
                }
                index += 1;
            }
        }
        let passed = letters.get(begun..index).unwrap_or_default();
        line += passed.iter().filter(|letter| **letter == '\n').count();
    }
    tokens
}

fn end_of_line(letters: &[char], from: usize) -> usize {
    let rest = letters.iter().skip(from);
    from + rest.take_while(|letter| **letter != '\n').count()
}

/// The end of a comment that may contain further comments.
fn end_of_comment(letters: &[char], from: usize) -> usize {
    let (mut depth, mut index) = (0, from);
    while index < letters.len() {
        match letters.get(index..index + 2) {
            Some(['/', '*']) => (depth, index) = (depth + 1, index + 2),
            Some(['*', '/']) => (depth, index) = (depth - 1, index + 2),
            _ => index += 1,
        }
        if depth == 0 {
            break;
        }
    }
    index
}

fn end_of_text(letters: &[char], from: usize) -> usize {
    let mut index = from + 1;
    while let Some(letter) = letters.get(index) {
        match letter {
            '\\' => index += 2,
            '"' => return index + 1,
            _ => index += 1,
        }
    }
    index
}

/// The end of a character literal, or of the quote of a lifetime.
fn end_of_quote(letters: &[char], from: usize) -> usize {
    match (letters.get(from + 1), letters.get(from + 2)) {
        (Some('\\'), _) => {
            let rest = letters.iter().skip(from + 3);
            from + 4 + rest.take_while(|letter| **letter != '\'').count()
        }
        (Some(_), Some('\'')) => from + 3,
        _ => from + 1,
    }
}

/// The end of a raw string literal that begins here, if there is one.
fn is_raw(letters: &[char], from: usize) -> Option<usize> {
    let mut index = from;
    if matches!(letters.get(index), Some('b' | 'c')) {
        index += 1;
    }
    if letters.get(index) != Some(&'r') {
        return None;
    }
    index += 1;
    let hashes = letters.iter().skip(index).take_while(|letter| **letter == '#').count();
    index += hashes;
    if letters.get(index) != Some(&'"') {
        return None;
    }
    index += 1;
    while index < letters.len() {
        let is_end = letters.get(index) == Some(&'"')
            && letters
                .iter()
                .skip(index + 1)
                .take(hashes)
                .filter(|letter| **letter == '#')
                .count()
                == hashes;
        index += 1;
        if is_end {
            return Some(index + hashes);
        }
    }
    Some(index)
}

/// The tokens without test-only items, and the names of the test modules in files of their own.
pub(super) fn without_tests(tokens: &[Token]) -> (Vec<Token>, Vec<String>) {
    const ATTRIBUTE: [&str; 7] = ["#", "[", "cfg", "(", "test", ")", "]"];
    let (mut kept, mut modules, mut index) = (Vec::new(), Vec::new(), 0);
    while let Some(token) = tokens.get(index) {
        let here = tokens.iter().skip(index).map(|token| token.text.as_str());
        if !here.take(ATTRIBUTE.len()).eq(ATTRIBUTE) {
            kept.push(token.clone());
            index += 1;
            continue;
        }
        index += ATTRIBUTE.len();
        let (mut depth, mut item) = (0_usize, Vec::new());
        while let Some(token) = tokens.get(index) {
            index += 1;
            item.push(token.text.as_str());
            match token.text.as_str() {
                "{" | "(" | "[" => depth += 1,
                "}" | ")" | "]" => depth = depth.saturating_sub(1),
                _ => {}
            }
            if depth == 0 && matches!(token.text.as_str(), ";" | "}") {
                break;
            }
        }
        if let [.., "mod", name, ";"] = item.as_slice() {
            modules.push((*name).to_owned());
        }
    }
    (kept, modules)
}
