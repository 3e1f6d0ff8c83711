//! Chooses mutants with a seed, spread over operators and files.

use crate::site::{Operator, Site};
use etherpen::hash::fnv1a;
use etherpen_segment::random::Random;
use std::collections::BTreeMap;

/// Indices of up to `count` sites that do not overlap. `excluded` sites are left out; where they stood, the next of the
/// seed follow, and the others stay.
#[must_use]
pub(crate) fn choose(sites: &[Site], seed: u64, count: usize, excluded: &[usize]) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    for site in ranking(sites, seed) {
        if chosen.len() == count {
            break;
        }
        let is_free = chosen.iter().all(|other| !sites[*other].overlaps(&sites[site]));
        if is_free && !excluded.contains(&site) {
            chosen.push(site);
        }
    }
    chosen
}

/// All sites in the order of the seed: operators take turns, and each takes a site of the file that had the fewest turns.
fn ranking(sites: &[Site], seed: u64) -> Vec<usize> {
    let numbered = sites.iter().enumerate();
    let mut shuffled: Vec<(u64, usize)> = numbered.map(|(number, site)| (rank(site, seed), number)).collect();
    shuffled.sort_unstable();
    let mut waiting: Vec<Vec<usize>> = Operator::ALL
        .iter()
        .map(|operator| {
            let of_operator = shuffled.iter().filter(|(_, site)| sites[*site].operator == *operator);
            of_operator.map(|(_, site)| *site).collect()
        })
        .collect();
    let mut turns: BTreeMap<&str, usize> = BTreeMap::new();
    let mut ranking = Vec::with_capacity(sites.len());
    while ranking.len() < sites.len() {
        for of_operator in &mut waiting {
            let turns_of = |site: &usize| turns.get(sites[*site].file.as_str()).copied().unwrap_or(0);
            let next = (0..of_operator.len()).min_by_key(|place| turns_of(&of_operator[*place]));
            if let Some(next) = next {
                let site = of_operator.remove(next);
                *turns.entry(&sites[site].file).or_default() += 1;
                ranking.push(site);
            }
        }
    }
    ranking
}

/// A site's random number: it depends on the site alone, so that a change elsewhere leaves most of a choice as it was.
fn rank(site: &Site, seed: u64) -> u64 {
    let Site {
        file,
        function,
        change,
        occurrence,
        ..
    } = site;
    let name = format!("{file} {function} {change} {occurrence:?}");
    Random::new(seed ^ fnv1a(name.bytes())).bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn site(file: usize, operator: Operator, start: usize) -> Site {
        Site {
            file: format!("file{file}"),
            function: format!("function{start}"),
            operator,
            range: start..start + 2,
            replacement: String::new(),
            change: String::new(),
            occurrence: None,
        }
    }

    fn many() -> Vec<Site> {
        let of = |number: usize| site(number % 7, Operator::ALL[number % 9], number / 2 * 2);
        (0..400).map(of).collect()
    }

    #[test]
    fn a_site_that_goes_leaves_most_of_the_choice() {
        let name = |site: &Site| (site.file.clone(), site.operator, site.range.clone());
        let mut sites = many();
        let chosen = choose(&sites, 1, 50, &[]);
        let before: Vec<_> = chosen.iter().map(|site| name(&sites[*site])).collect();
        sites.remove(chosen[20]);
        let after = choose(&sites, 1, 50, &[]);
        let kept = after
            .iter()
            .filter(|site| before.contains(&name(&sites[**site])))
            .count();
        assert!(kept >= 40, "{kept}");
    }

    #[test]
    fn one_seed_chooses_the_same_and_another_seed_others() {
        let sites = many();
        assert_eq!(choose(&sites, 1, 50, &[]), choose(&sites, 1, 50, &[]));
        assert_ne!(choose(&sites, 1, 50, &[]), choose(&sites, 2, 50, &[]));
    }

    #[test]
    fn chosen_sites_do_not_overlap_and_are_spread_over_operators_and_files() {
        let sites = many();
        for seed in 0..20 {
            let chosen = choose(&sites, seed, 63, &[]);
            assert_eq!(chosen.len(), 63, "seed {seed}");
            for (number, one) in chosen.iter().enumerate() {
                let others = &chosen[number + 1..];
                assert!(
                    others.iter().all(|other| !sites[*one].overlaps(&sites[*other])),
                    "seed {seed}"
                );
            }
            for operator in Operator::ALL {
                let count = chosen.iter().filter(|site| sites[**site].operator == operator).count();
                assert!((5..=9).contains(&count), "seed {seed}: {operator:?} {count} times");
            }
            for file in 0..7 {
                let name = format!("file{file}");
                let count = chosen.iter().filter(|site| sites[**site].file == name).count();
                assert!((7..=11).contains(&count), "seed {seed}: {name} {count} times");
            }
        }
    }

    #[test]
    fn an_excluded_site_is_replaced_and_those_before_it_stay() {
        let sites = many();
        let before = choose(&sites, 3, 40, &[]);
        let after = choose(&sites, 3, 40, &[before[20]]);
        assert_eq!(after.len(), 40);
        assert_eq!(before[..20], after[..20]);
        assert!(!after.contains(&before[20]));
    }
}
