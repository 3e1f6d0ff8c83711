//! SVG.

use super::{FILE_BYTES, Hostile, filled, numbered};

pub(super) const FILES: &[Hostile] = &[
    Hostile {
        name: "points.svg",
        make: || path("M0 0", "h1v1", ""),
    },
    Hostile {
        name: "moves.svg",
        make: || path("", "M0 0h1", ""),
    },
    Hostile {
        name: "large-curves.svg",
        make: || path("M0 0", "C90000 0 0 90000 1 1", ""),
    },
    Hostile {
        name: "large-arcs.svg",
        make: || path("M0 0", "A9e5 9e5 0 1 0 1 1", ""),
    },
    Hostile {
        name: "elements.svg",
        make: || filled(HEAD, "<path d='M0 0h9'/>", "</svg>"),
    },
    Hostile {
        name: "empty-elements.svg",
        make: || filled(HEAD, "<g/>", "</svg>"),
    },
    Hostile {
        name: "attributes.svg",
        make: || {
            numbered(
                "<svg xmlns='http://www.w3.org/2000/svg'><path d='M0 0h9' ",
                |n| format!("a{n}='' "),
                "/></svg>",
            )
        },
    },
    Hostile {
        name: "depth.svg",
        make: || nested("<g>", "</g>"),
    },
    Hostile {
        name: "depth-of-pages.svg",
        make: || nested("<svg>", "</svg>"),
    },
    Hostile {
        name: "depth-without-end.svg",
        make: || filled(HEAD, "<g>", ""),
    },
    Hostile {
        name: "depth-of-transforms.svg",
        make: || nested("<g transform='rotate(1)'>", "</g>"),
    },
    Hostile {
        name: "depth-of-letters.svg",
        make: || nested("<text>a<tspan>", "</tspan></text>"),
    },
    Hostile {
        name: "rules.svg",
        make: rules,
    },
    Hostile {
        name: "selectors.svg",
        make: || {
            filled(
                &format!("{HEAD}<style>"),
                "a b>c:first-child .d,",
                "*{fill:red}</style><path d='M0 0h9'/></svg>",
            )
        },
    },
    Hostile {
        name: "styles.svg",
        make: || filled(&format!("{HEAD}<path d='M0 0h9' style='"), "fill:red;", "'/></svg>"),
    },
    Hostile {
        name: "colours.svg",
        make: || numbered(HEAD, |n| format!("<path stroke='#{n:06x}' d='M0 0h9'/>"), "</svg>"),
    },
    Hostile {
        name: "layers.svg",
        make: layers,
    },
    Hostile {
        name: "names.svg",
        make: || numbered(HEAD, |n| format!("<g id='a{n}'/>"), "</svg>"),
    },
    Hostile {
        name: "uses.svg",
        make: || {
            filled(
                &format!("{HEAD}<path id='p' d='M0 0h9'/>"),
                "<use href='#p'/>",
                "</svg>",
            )
        },
    },
    Hostile {
        name: "chain-of-uses.svg",
        make: || {
            numbered(
                HEAD,
                |n| format!("<g id='u{}'><use href='#u{n}'/></g>", n + 1),
                "<path id='u0' d='M0 0h9'/></svg>",
            )
        },
    },
    Hostile {
        name: "uses-of-uses.svg",
        make: uses_of_uses,
    },
    Hostile {
        name: "chain-of-clips.svg",
        make: || {
            numbered(
                HEAD,
                |n| {
                    format!(
                        "<clipPath id='c{}' clip-path='url(#c{n})'><path d='M0 0h9v9z'/></clipPath>",
                        n + 1
                    )
                },
                "<path clip-path='url(#c9999)' d='M0 0h9'/></svg>",
            )
        },
    },
    Hostile {
        name: "clips.svg",
        make: clips,
    },
    Hostile {
        name: "gradients.svg",
        make: || {
            numbered(
                HEAD,
                |n| format!("<linearGradient id='l{}' href='#l{n}'/>", n + 1),
                "<path fill='url(#l9999)' d='M0 0h9v9z'/></svg>",
            )
        },
    },
    Hostile {
        name: "markers.svg",
        make: || {
            path_with(
                "<marker id='m' orient='auto'><path d='M0 0h1v1z'/></marker>",
                " stroke='red' marker-mid='url(#m)'",
                "h1v1",
            )
        },
    },
    Hostile {
        name: "dashes.svg",
        make: || {
            filled(
                &format!("{HEAD}<g stroke='red' stroke-dasharray='.01'>"),
                "<path d='M0 0H900'/>",
                "</g></svg>",
            )
        },
    },
    Hostile {
        name: "list-of-dashes.svg",
        make: || {
            filled(
                &format!("{HEAD}<path stroke='red' d='M0 0H90000' stroke-dasharray='"),
                "1 ",
                "'/></svg>",
            )
        },
    },
    Hostile {
        name: "letters.svg",
        make: || filled(&format!("{HEAD}<text x='1' y='9'>"), "Hamburg ", "</text></svg>"),
    },
    Hostile {
        name: "texts.svg",
        make: || filled(HEAD, "<text>A</text>", "</svg>"),
    },
    Hostile {
        name: "places-of-letters.svg",
        make: || filled(&format!("{HEAD}<text x='"), "1 ", "'>A</text></svg>"),
    },
    Hostile {
        name: "transforms.svg",
        make: || filled(&format!("{HEAD}<path d='M0 0h9' transform='"), "rotate(1)", "'/></svg>"),
    },
    Hostile {
        name: "switches.svg",
        make: || {
            filled(
                &format!("{HEAD}<switch>"),
                "<path d='M0 0h9' systemLanguage='xx'/>",
                "</switch></svg>",
            )
        },
    },
    Hostile {
        name: "laughs.svg",
        make: laughs,
    },
    Hostile {
        name: "comments.svg",
        make: || filled(HEAD, "<!---->", "</svg>"),
    },
    Hostile {
        name: "patterns.svg",
        make: || {
            filled(
                &format!("{HEAD}<pattern id='p' width='1' height='1'><path d='M0 0h1'/></pattern>"),
                "<path fill='url(#p)' d='M0 0h9v9z'/>",
                "</svg>",
            )
        },
    },
    Hostile {
        name: "filters.svg",
        make: || {
            filled(
                &format!("{HEAD}<filter id='f'><feFlood/></filter>"),
                "<g filter='url(#f)'><path d='M0 0h9'/></g>",
                "</svg>",
            )
        },
    },
];

const HEAD: &str = "<svg xmlns='http://www.w3.org/2000/svg' xmlns:inkscape='http://www.inkscape.org/namespaces/inkscape' \
                    width='100mm' height='100mm' viewBox='0 0 100 100'>";

fn path(start: &str, part: &str, end: &str) -> Vec<u8> {
    filled(&format!("{HEAD}<path d='{start}"), part, &format!("{end}'/></svg>"))
}

fn path_with(definitions: &str, attributes: &str, part: &str) -> Vec<u8> {
    filled(
        &format!("{HEAD}{definitions}<path{attributes} d='M0 0"),
        part,
        "'/></svg>",
    )
}

fn nested(open: &str, close: &str) -> Vec<u8> {
    let depth = (FILE_BYTES - 1_000) / (open.len() + close.len());
    format!(
        "{HEAD}{}<path d='M0 0h9'/>{}</svg>",
        open.repeat(depth),
        close.repeat(depth)
    )
    .into_bytes()
}

/// As many style rules as elements, each of which has to be compared with each.
fn rules() -> Vec<u8> {
    let mut text = format!("{HEAD}<style>");
    for number in 0..FILE_BYTES / 2 / 18 {
        text += &format!(".a{number}{{fill:red}}");
    }
    text += "</style>";
    numbered(
        &text,
        |number| format!("<path class='a{number}' d='M0 0h9'/>"),
        "</svg>",
    )
}

fn layers() -> Vec<u8> {
    let layer = |number| format!("<g inkscape:groupmode='layer' inkscape:label='{number}'><path d='M0 0h9'/></g>");
    numbered(HEAD, layer, "</svg>")
}

/// A tree of references in which each level has ten references to the level below.
fn uses_of_uses() -> Vec<u8> {
    let mut text = format!("{HEAD}<path id='u0' d='M0 0h9'/>");
    for level in 1..=12 {
        let below = format!("<use href='#u{}'/>", level - 1);
        text += &format!("<g id='u{level}'>{}</g>", below.repeat(10));
    }
    filled(&text, "<use href='#u12'/>", "</svg>")
}

/// Long lines clipped by a long line.
fn clips() -> Vec<u8> {
    let clip = format!(
        "<clipPath id='c'><path d='M0 0{}z'/></clipPath>",
        "l9 9l9 -9".repeat(FILE_BYTES / 18)
    );
    filled(
        &format!("{HEAD}{clip}<g clip-path='url(#c)'>"),
        "<path d='M0 5H90000'/>",
        "</g></svg>",
    )
}

fn laughs() -> Vec<u8> {
    let mut text = String::from("<!DOCTYPE svg [<!ENTITY e0 '<path d=\"M0 0h9\"/>'>");
    for level in 1..=30 {
        let below = format!("&e{};", level - 1);
        text += &format!("<!ENTITY e{level} '{}'>", below.repeat(10));
    }
    filled(&format!("{text}]>{HEAD}"), "&e30;", "</svg>")
}
