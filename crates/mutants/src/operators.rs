//! Finds the places of a source file where mutants can be.
//!
//! Not visited: tests, constants and `const fn` (a switch is not constant), patterns, arguments of macros, code under
//! `cfg`, and what only prints (`Display`, `Debug`).

use crate::site::{ORDERED, Operator, SWITCH, Site};
use std::collections::BTreeMap;
use std::ops::Range;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{BinOp, Expr, Stmt, UnOp};

/// All sites of a file, in their order.
///
/// # Errors
/// The file is not Rust.
pub(crate) fn sites(file: &str, text: &str) -> Result<Vec<Site>, syn::Error> {
    let parsed = syn::parse_file(text)?;
    let mut finder = Finder {
        file,
        text,
        scope: Vec::new(),
        sites: Vec::new(),
    };
    finder.visit_file(&parsed);
    finder.sites.sort_by_key(|site| (site.range.start, site.range.end));
    number_equal_changes(&mut finder.sites);
    Ok(finder.sites)
}

/// Numbers the sites of a file that have the same change in the same function.
fn number_equal_changes(sites: &mut [Site]) {
    let mut places: BTreeMap<(String, String), Vec<usize>> = BTreeMap::new();
    for (place, site) in sites.iter().enumerate() {
        let key = (site.function.clone(), site.change.clone());
        places.entry(key).or_default().push(place);
    }
    for equal in places.into_values().filter(|equal| equal.len() > 1) {
        for (occurrence, place) in (1..).zip(equal) {
            sites[place].occurrence = Some(occurrence);
        }
    }
}

/// Names of the modules that a file declares in files of their own, for tests only.
///
/// # Errors
/// The file is not Rust.
pub(crate) fn test_modules(text: &str) -> Result<Vec<String>, syn::Error> {
    let items = syn::parse_file(text)?.items;
    let modules = items.into_iter().filter_map(|item| match item {
        syn::Item::Mod(module) if module.content.is_none() && is_excluded(&module.attrs) => {
            Some(module.ident.to_string())
        }
        _ => None,
    });
    Ok(modules.collect())
}

/// Whether an item is a test, or is compiled under a condition only.
fn is_excluded(attributes: &[syn::Attribute]) -> bool {
    attributes
        .iter()
        .any(|attribute| attribute.path().is_ident("test") || attribute.path().is_ident("cfg"))
}

struct Finder<'a> {
    file: &'a str,
    text: &'a str,
    /// Names of the types and functions around.
    scope: Vec<String>,
    sites: Vec<Site>,
}

impl Finder<'_> {
    fn code(&self, range: &Range<usize>) -> &str {
        &self.text[range.clone()]
    }

    fn code_of(&self, node: &impl Spanned) -> &str {
        self.code(&bytes(node))
    }

    fn add(&mut self, operator: Operator, range: Range<usize>, replacement: String, change: String) {
        self.sites.push(Site {
            file: self.file.to_owned(),
            function: self.scope.join("::"),
            operator,
            range,
            replacement,
            change,
            occurrence: None,
        });
    }

    /// Another expression in place of an expression.
    fn replace(&mut self, operator: Operator, node: &impl Spanned, mutant: &str) {
        self.replace_with(operator, node, mutant, mutant);
    }

    /// Another expression, and how it is shown.
    fn replace_with(&mut self, operator: Operator, node: &impl Spanned, mutant: &str, simple: &str) {
        let range = bytes(node);
        let original = self.code(&range);
        let replacement = format!("(if {SWITCH} {{ {mutant} }} else {{ {original} }})");
        let change = format!("{} becomes {}", shown(original), shown(simple));
        self.add(operator, range, replacement, change);
    }

    /// An expression without a value left out.
    fn drop_action(&mut self, operator: Operator, node: &impl Spanned) {
        let range = bytes(node);
        let original = self.code(&range);
        let replacement = format!("(if !{SWITCH} {{ {original}; }})");
        let change = format!("{} left out", shown(original));
        self.add(operator, range, replacement, change);
    }

    fn comparison(&mut self, binary: &syn::ExprBinary) {
        let (turned, boundary) = match binary.op {
            BinOp::Lt(_) => (">=", Some("<=")),
            BinOp::Le(_) => (">", Some("<")),
            BinOp::Gt(_) => ("<=", Some(">=")),
            BinOp::Ge(_) => ("<", Some(">")),
            BinOp::Eq(_) => ("!=", None),
            BinOp::Ne(_) => ("==", None),
            _ => return,
        };
        let (left, right) = (self.code_of(&binary.left), self.code_of(&binary.right));
        let simple = |sign: &str| format!("{left} {sign} {right}");
        let opposite = (format!("({left}) {turned} ({right})"), simple(turned));
        let moved = boundary.map(|sign| {
            let mutant = format!("{ORDERED}(&({left})) {sign} {ORDERED}(&({right}))");
            (mutant, simple(sign))
        });
        self.replace_with(Operator::Turned, binary, &opposite.0, &opposite.1);
        if let Some((mutant, simple)) = moved {
            self.replace_with(Operator::Boundary, binary, &mutant, &simple);
        }
    }

    /// One side of `&&` or `||` left out, unless it binds names or is itself such an operation.
    fn sides(&mut self, binary: &syn::ExprBinary) {
        let is_and = match binary.op {
            BinOp::And(_) => true,
            BinOp::Or(_) => false,
            _ => return,
        };
        let same = |inner: &BinOp| matches!((inner, is_and), (BinOp::And(_), true) | (BinOp::Or(_), false));
        for side in [&binary.left, &binary.right] {
            let is_chain = matches!(&**side, Expr::Binary(inner) if same(&inner.op));
            if is_chain || binds(side) {
                continue;
            }
            let range = bytes(side);
            let original = self.code(&range);
            let (replacement, sign) = match is_and {
                true => (format!("({SWITCH} || ({original}))"), "&&"),
                false => (format!("(!{SWITCH} && ({original}))"), "||"),
            };
            let change = format!("{} left out of `{sign}`", shown(original));
            self.add(Operator::Side, range, replacement, change);
        }
    }

    fn method_statement(&mut self, call: &syn::ExprMethodCall) {
        match call.method.to_string().as_str() {
            "latch" | "get_or_insert" => self.drop_action(Operator::Latch, call),
            "clear" | "reset" | "restart" => self.drop_action(Operator::Reset, call),
            _ => {}
        }
    }

    /// Visits what belongs to a named scope.
    fn within(&mut self, name: String, visit: impl FnOnce(&mut Self)) {
        self.scope.push(name);
        visit(self);
        self.scope.pop();
    }
}

impl<'ast> Visit<'ast> for Finder<'_> {
    fn visit_item_fn(&mut self, function: &'ast syn::ItemFn) {
        if function.sig.constness.is_none() && !is_excluded(&function.attrs) {
            self.within(function.sig.ident.to_string(), |finder| {
                finder.visit_block(&function.block);
            });
        }
    }

    fn visit_impl_item_fn(&mut self, function: &'ast syn::ImplItemFn) {
        if function.sig.constness.is_none() && !is_excluded(&function.attrs) {
            self.within(function.sig.ident.to_string(), |finder| {
                finder.visit_block(&function.block);
            });
        }
    }

    fn visit_trait_item_fn(&mut self, function: &'ast syn::TraitItemFn) {
        if let Some(block) = &function.default {
            self.within(function.sig.ident.to_string(), |finder| finder.visit_block(block));
        }
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        let prints = item.trait_.as_ref().is_some_and(|(_, path, _)| {
            let name = path.segments.last().map(|segment| segment.ident.to_string());
            matches!(name.as_deref(), Some("Display" | "Debug"))
        });
        if !prints && !is_excluded(&item.attrs) {
            let name = match &*item.self_ty {
                syn::Type::Path(path) => path.path.segments.last().map(|segment| segment.ident.to_string()),
                _ => None,
            };
            self.within(name.unwrap_or_else(|| "impl".to_owned()), |finder| {
                visit::visit_item_impl(finder, item);
            });
        }
    }

    fn visit_item_trait(&mut self, item: &'ast syn::ItemTrait) {
        self.within(item.ident.to_string(), |finder| visit::visit_item_trait(finder, item));
    }

    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        if !is_excluded(&module.attrs) {
            visit::visit_item_mod(self, module);
        }
    }

    fn visit_expr_binary(&mut self, binary: &'ast syn::ExprBinary) {
        self.comparison(binary);
        self.sides(binary);
        if matches!(binary.op, BinOp::AddAssign(_)) && is_state(&binary.left) {
            self.drop_action(Operator::Count, binary);
        }
        visit::visit_expr_binary(self, binary);
    }

    fn visit_expr_assign(&mut self, assignment: &'ast syn::ExprAssign) {
        if let Some(operator) = is_state(&assignment.left)
            .then(|| assigned(&assignment.right))
            .flatten()
        {
            self.drop_action(operator, assignment);
        }
        visit::visit_expr_assign(self, assignment);
    }

    fn visit_expr_method_call(&mut self, call: &'ast syn::ExprMethodCall) {
        let arguments = call.args.len();
        let is_limit = match call.method.to_string().as_str() {
            "min" | "max" => arguments == 1,
            "clamp" => arguments == 2,
            _ => false,
        };
        if is_limit {
            let receiver = self.code_of(&call.receiver).to_owned();
            self.replace(Operator::Limit, call, &receiver);
        }
        visit::visit_expr_method_call(self, call);
    }

    fn visit_expr_call(&mut self, call: &'ast syn::ExprCall) {
        let is_limit = matches!(&*call.func, Expr::Path(path) if path.path.is_ident("limited"));
        if is_limit && let Some(value) = call.args.first() {
            let value = self.code_of(value).to_owned();
            self.replace(Operator::Limit, call, &value);
        }
        visit::visit_expr_call(self, call);
    }

    fn visit_expr_unary(&mut self, unary: &'ast syn::ExprUnary) {
        if matches!(unary.op, UnOp::Not(_)) {
            let inner = self.code_of(&unary.expr).to_owned();
            self.replace(Operator::Not, unary, &inner);
        }
        visit::visit_expr_unary(self, unary);
    }

    fn visit_expr_if(&mut self, branch: &'ast syn::ExprIf) {
        if branch.else_branch.is_none() && leaves(&branch.then_branch) {
            let range = bytes(&branch.cond);
            let original = self.code(&range);
            let replacement = match binds(&branch.cond) {
                true => format!("!{SWITCH} && {original}"),
                false => format!("!{SWITCH} && ({original})"),
            };
            let change = format!("{} left out", shown(&format!("if {original} {{ .. }}")));
            self.add(Operator::Guard, range, replacement, change);
        }
        visit::visit_expr_if(self, branch);
    }

    fn visit_stmt(&mut self, statement: &'ast Stmt) {
        if let Stmt::Expr(Expr::MethodCall(call), Some(_)) = statement {
            self.method_statement(call);
        }
        visit::visit_stmt(self, statement);
    }

    // Constants, patterns and attributes have no sites.
    fn visit_expr_const(&mut self, _: &'ast syn::ExprConst) {}
    fn visit_item_const(&mut self, _: &'ast syn::ItemConst) {}
    fn visit_item_static(&mut self, _: &'ast syn::ItemStatic) {}
    fn visit_item_enum(&mut self, _: &'ast syn::ItemEnum) {}
    fn visit_impl_item_const(&mut self, _: &'ast syn::ImplItemConst) {}
    fn visit_trait_item_const(&mut self, _: &'ast syn::TraitItemConst) {}
    fn visit_expr_repeat(&mut self, repeat: &'ast syn::ExprRepeat) {
        self.visit_expr(&repeat.expr);
    }
    fn visit_type(&mut self, _: &'ast syn::Type) {}
    fn visit_generic_argument(&mut self, _: &'ast syn::GenericArgument) {}
    fn visit_pat(&mut self, _: &'ast syn::Pat) {}
    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}
}

fn bytes(node: &impl Spanned) -> Range<usize> {
    node.span().byte_range()
}

/// Code in backticks, in one line, shortened.
fn shown(code: &str) -> String {
    const LONGEST: usize = 70;
    let line = code.split_whitespace().collect::<Vec<_>>().join(" ");
    match line.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("`{}…`", &line[..end]),
        None => format!("`{line}`"),
    }
}

/// Whether an expression of a condition binds names with `let`.
fn binds(condition: &Expr) -> bool {
    match condition {
        Expr::Let(_) => true,
        Expr::Binary(binary) => binds(&binary.left) || binds(&binary.right),
        _ => false,
    }
}

/// Whether a block ends the function or the turn of a loop.
fn leaves(block: &syn::Block) -> bool {
    let last = match block.stmts.last() {
        Some(Stmt::Expr(last, _)) => last,
        _ => return false,
    };
    matches!(last, Expr::Return(_) | Expr::Break(_) | Expr::Continue(_))
}

/// Whether an assignment's target outlives the function: a field, an element, something behind a reference.
fn is_state(target: &Expr) -> bool {
    match target {
        Expr::Field(_) | Expr::Index(_) => true,
        Expr::Unary(unary) => matches!(unary.op, UnOp::Deref(_)),
        Expr::Tuple(tuple) => tuple.elems.iter().all(is_state),
        _ => false,
    }
}

/// Operator of the mutant that leaves out an assignment of this value; `None` if such an assignment has no mutant.
fn assigned(value: &Expr) -> Option<Operator> {
    match value {
        Expr::Lit(literal) => of_literal(&literal.lit),
        Expr::Array(array) => array.elems.first().and_then(assigned),
        Expr::Repeat(repeat) => assigned(&repeat.expr),
        Expr::Tuple(tuple) => {
            let operators = tuple.elems.iter().map(assigned);
            let same = |one: Option<Operator>, other| if one == other { one } else { None };
            operators.reduce(same).flatten()
        }
        Expr::Path(path) if path.path.is_ident("None") => Some(Operator::Reset),
        // A variant or a constant.
        Expr::Path(path) => {
            let last = path.path.segments.last()?.ident.to_string();
            (path.path.segments.len() > 1 && last.starts_with(char::is_uppercase)).then_some(Operator::Latch)
        }
        Expr::Struct(_) => Some(Operator::Latch),
        Expr::Call(call) => match &*call.func {
            Expr::Path(path) => match path.path.segments.last()?.ident.to_string().as_str() {
                "new" | "default" => Some(Operator::Reset),
                name => name.starts_with(char::is_uppercase).then_some(Operator::Latch),
            },
            _ => None,
        },
        Expr::MethodCall(call) => {
            let method = call.method.to_string();
            matches!(method.as_str(), "saturating_add" | "wrapping_add").then_some(Operator::Count)
        }
        _ => None,
    }
}

fn of_literal(literal: &syn::Lit) -> Option<Operator> {
    match literal {
        syn::Lit::Bool(flag) if flag.value => Some(Operator::Latch),
        syn::Lit::Bool(_) => Some(Operator::Reset),
        syn::Lit::Int(number) if number.base10_digits() == "0" => Some(Operator::Reset),
        syn::Lit::Float(number) if number.base10_parse().is_ok_and(|number: f64| number == 0.0) => {
            Some(Operator::Reset)
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests;
