//! The node hierarchy (glTF 2.0 §3.5): which nodes the scene shows, and where they stand in the world.
//!
//! The file may claim any graph. Only a forest is accepted; it is walked with a stack of its own, so that depth costs
//! no call stack.

use glam::DAffine3;

use super::document::Document;
use super::error::{Checked, Fault};
use super::extras::{Keys, NodeExtras};
use super::notes::Notes;

/// A node of the scene in the world.
#[derive(Clone, Debug)]
pub struct Visit {
    pub node: usize,
    /// Node to world.
    pub world: DAffine3,
    /// The node or one above it is moved by an animation.
    pub animated: bool,
    /// Hidden by KHR_node_visibility, on the node or above it.
    pub hidden: bool,
    pub extras: NodeExtras,
    /// The node's own keys.
    pub keys: Keys,
}

/// All nodes of the default scene (the first one if there is no default, all roots if there is no scene), parents
/// before children, in the order of the file.
pub fn walk(document: &Document, notes: &mut Notes) -> Checked<Vec<Visit>> {
    let parents = parents(document)?;
    refuse_cycles(document, &parents)?;
    let roots = roots(document, &parents)?;
    let mut visits = Vec::new();
    let start = |&node: &usize| (node, DAffine3::IDENTITY, false, false, NodeExtras::default());
    let mut stack: Vec<_> = roots.iter().rev().map(start).collect();
    while let Some((index, above, animated, hidden, extras)) = stack.pop() {
        let Some(node) = document.root.nodes.get(index) else { continue };
        let place = document.node_place(index);
        let local = document.locals.get(index).map_or(DAffine3::IDENTITY, |l| l.affine());
        let world = above * local;
        if !world.is_finite() {
            return Err(Fault::invalid(place, "its transform in the world is not finite"));
        }
        let keys = Keys::read(&node.extras, &place, notes);
        let visit = Visit {
            node: index,
            world,
            animated: animated || document.animated.get(index).copied().unwrap_or(false),
            hidden: hidden || is_hidden(node),
            extras: extras.with(&keys),
            keys,
        };
        let below = (visit.world, visit.animated, visit.hidden, visit.extras.clone());
        let children = node.children.as_deref().unwrap_or_default();
        stack.extend(children.iter().rev().map(|c| (c.value(), below.0, below.1, below.2, below.3.clone())));
        visits.push(visit);
    }
    Ok(visits)
}

/// World transform of every node of the document, whether or not a scene shows it; needed for skins, whose joints may
/// hang anywhere.
pub fn all_worlds(document: &Document) -> Checked<Vec<DAffine3>> {
    let parents = parents(document)?;
    refuse_cycles(document, &parents)?;
    let mut worlds = vec![DAffine3::IDENTITY; parents.len()];
    let mut stack: Vec<usize> = (0..parents.len()).filter(|&i| parents[i].is_none()).collect();
    while let Some(index) = stack.pop() {
        let above = parents.get(index).copied().flatten().and_then(|p| worlds.get(p)).copied();
        let local = document.locals.get(index).map_or(DAffine3::IDENTITY, |l| l.affine());
        if let Some(world) = worlds.get_mut(index) {
            *world = above.unwrap_or(DAffine3::IDENTITY) * local;
        }
        if let Some(node) = document.root.nodes.get(index) {
            stack.extend(node.children.iter().flatten().map(|c| c.value()));
        }
    }
    Ok(worlds)
}

/// The one parent of every node.
fn parents(document: &Document) -> Checked<Vec<Option<usize>>> {
    let nodes = &document.root.nodes;
    let mut parents: Vec<Option<usize>> = vec![None; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        for child in node.children.iter().flatten() {
            let place = || document.node_place(index);
            let slot = parents.get_mut(child.value());
            let slot = slot.ok_or_else(|| {
                Fault::invalid(
                    place(),
                    format!("it has the child {}, but there are {} nodes", child.value(), nodes.len()),
                )
            })?;
            if let Some(other) = slot.replace(index) {
                let what = format!("its child {} is also a child of {}", child.value(), document.node_place(other));
                return Err(Fault::invalid(place(), what));
            }
        }
    }
    Ok(parents)
}

/// With one parent each, nodes form trees and cycles; what cannot be reached from a root lies on or below a cycle.
fn refuse_cycles(document: &Document, parents: &[Option<usize>]) -> Checked<()> {
    let mut reached = vec![false; parents.len()];
    let mut stack: Vec<usize> = (0..parents.len()).filter(|&i| parents[i].is_none()).collect();
    while let Some(index) = stack.pop() {
        if let Some(flag) = reached.get_mut(index) {
            *flag = true;
        }
        if let Some(node) = document.root.nodes.get(index) {
            stack.extend(node.children.iter().flatten().map(|c| c.value()));
        }
    }
    match reached.iter().position(|reached| !reached) {
        None => Ok(()),
        Some(index) => Err(Fault::invalid(document.node_place(index), "it is its own ancestor, or below one that is")),
    }
}

fn roots(document: &Document, parents: &[Option<usize>]) -> Checked<Vec<usize>> {
    let root = &document.root;
    let Some(scene) = root.scenes.get(root.scene.map_or(0, |s| s.value())) else {
        if let Some(scene) = root.scene {
            let what = format!("the default scene {} does not exist", scene.value());
            return Err(Fault::invalid("scene", what));
        }
        return Ok((0..parents.len()).filter(|&i| parents[i].is_none()).collect());
    };
    let mut listed = vec![false; parents.len()];
    let mut roots = Vec::with_capacity(scene.nodes.len());
    for index in &scene.nodes {
        let index = index.value();
        let place = || super::error::place("scene", root.scene.map_or(0, |s| s.value()), scene.name.as_deref());
        let (Some(parent), Some(listed)) = (parents.get(index), listed.get_mut(index)) else {
            return Err(Fault::invalid(place(), format!("its node {index} does not exist")));
        };
        if let Some(parent) = parent {
            let what = format!("its node {index} is a child of {}, so it is no root", document.node_place(*parent));
            return Err(Fault::invalid(place(), what));
        }
        if std::mem::replace(listed, true) {
            return Err(Fault::invalid(place(), format!("it lists node {index} twice")));
        }
        roots.push(index);
    }
    Ok(roots)
}

fn is_hidden(node: &gltf_json::Node) -> bool {
    let visibility = node.extensions.as_ref().and_then(|e| e.others.get("KHR_node_visibility"));
    visibility.and_then(|v| v.get("visible")?.as_bool()) == Some(false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::options::Limits;

    fn visits(rest: &str) -> Checked<Vec<Visit>> {
        let json = format!(r#"{{"asset":{{"version":"2.0"}},{rest}}}"#);
        walk(&Document::parse(json.as_bytes(), &Limits::default())?, &mut Notes::default())
    }

    fn order(rest: &str) -> Vec<usize> {
        visits(rest).unwrap().iter().map(|v| v.node).collect()
    }

    #[test]
    fn scenes_and_roots() {
        let nodes = r#""nodes":[{},{"children":[2,0]},{},{}]"#;
        assert_eq!(order(nodes), [1, 2, 0, 3], "no scene: all roots");
        assert_eq!(order(&format!(r#"{nodes},"scenes":[{{"nodes":[3]}},{{"nodes":[1]}}]"#)), [3], "the first scene");
        assert_eq!(order(&format!(r#"{nodes},"scene":1,"scenes":[{{"nodes":[3]}},{{"nodes":[1]}}]"#)), [1, 2, 0]);
        assert!(visits(&format!(r#"{nodes},"scene":2,"scenes":[{{"nodes":[3]}}]"#)).is_err());
    }

    #[test]
    fn only_forests_are_accepted() {
        for (nodes, word) in [
            (r#""nodes":[{"children":[0]}]"#, "ancestor"),
            (r#""nodes":[{"children":[1]},{"children":[2]},{"children":[0]}]"#, "ancestor"),
            (r#""nodes":[{"children":[2]},{"children":[2]},{}]"#, "also a child"),
            (r#""nodes":[{"children":[1,1]},{}]"#, "also a child"),
            (r#""nodes":[{"children":[7]}]"#, "there are 1 nodes"),
            (r#""nodes":[{"children":[1]},{}],"scenes":[{"nodes":[0,1]}]"#, "no root"),
            (r#""nodes":[{}],"scenes":[{"nodes":[0,0]}]"#, "twice"),
            (r#""nodes":[{}],"scenes":[{"nodes":[5]}]"#, "does not exist"),
        ] {
            let fault = visits(nodes).unwrap_err();
            assert!(fault.what.contains(word), "{nodes}: {fault}");
        }
    }

    #[test]
    fn depth_costs_no_call_stack() {
        let n = 200_000;
        let nodes: Vec<String> = (0..n).map(|i| format!(r#"{{"children":[{}]}}"#, i + 1)).collect();
        let all = visits(&format!(r#""nodes":[{},{{}}]"#, nodes.join(","))).unwrap();
        assert_eq!(all.len(), n + 1);
    }

    #[test]
    fn transforms_and_flags_reach_the_children() {
        let all = visits(
            r#""nodes":[{"translation":[1,0,0],"children":[1],"extras":{"luxel_receive":false}},
                        {"scale":[2,2,2],"children":[2]},{"translation":[0,1,0]}],
               "animations":[{"channels":[{"sampler":0,"target":{"node":1,"path":"scale"}}],"samplers":[]}]"#,
        )
        .unwrap();
        assert_eq!(all[2].world.translation, glam::DVec3::new(1.0, 2.0, 0.0));
        assert_eq!(all.iter().map(|v| v.animated).collect::<Vec<_>>(), [false, true, true]);
        assert!(all.iter().all(|v| !v.extras.receive));
    }
}
