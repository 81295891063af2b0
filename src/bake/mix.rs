//! Other weights of light groups: their stored light is summed anew, and nothing is gathered.

use std::collections::BTreeMap;
use std::str::FromStr;

use luxel_scene::import::power::BRIGHTEST;

use super::groups::Lighting;
use crate::Error;

/// Factors on the light of groups, by their names; groups that are not named stay as they are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mix(BTreeMap<String, f32>);

/// What `--mix` cannot mean.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MixError {
    #[error("`{0}` is no weight: write GROUP=FACTOR, several with commas between them (sun=0.2,lamps=1.5)")]
    Form(String),
    #[error("the factor of `{name}` must be a number from 0 upwards, not `{factor}`")]
    Factor { name: String, factor: String },
    #[error("`{0}` is weighed twice")]
    Twice(String),
}

impl FromStr for Mix {
    type Err = MixError;

    fn from_str(text: &str) -> Result<Self, MixError> {
        let mut mix = Self::default();
        // Names may hold commas, factors do not.
        let mut name_so_far = String::new();
        for piece in text.split(',') {
            let Some((name, factor)) = piece.rsplit_once('=') else {
                name_so_far += piece;
                name_so_far.push(',');
                continue;
            };
            let name = std::mem::take(&mut name_so_far) + name;
            let name = name.trim().to_owned();
            if name.is_empty() {
                return Err(MixError::Form(text.into()));
            }
            let value: Option<f32> = factor.trim().parse().ok().filter(|f: &f32| f.is_finite() && *f >= 0.0);
            let Some(value) = value else { return Err(MixError::Factor { name, factor: factor.into() }) };
            if mix.0.insert(name.clone(), value).is_some() {
                return Err(MixError::Twice(name));
            }
        }
        if name_so_far.is_empty() { Ok(mix) } else { Err(MixError::Form(text.into())) }
    }
}

impl Mix {
    /// This mix with the weights of another.
    ///
    /// # Errors
    /// A group that both weigh.
    pub fn and(mut self, other: Self) -> Result<Self, MixError> {
        for (name, factor) in other.0 {
            if self.0.insert(name.clone(), factor).is_some() {
                return Err(MixError::Twice(name));
            }
        }
        Ok(self)
    }

    /// Weighs the groups of a scene; returns the weight of every one of them.
    ///
    /// # Errors
    /// A name that is no group of the scene; a factor that makes a group brighter than any light of a scene may be.
    pub fn weigh(&self, lighting: &mut Lighting) -> Result<BTreeMap<String, f64>, Error> {
        let names = || lighting.groups.iter().map(|g| format!("{:?}", g.name)).collect::<Vec<_>>().join(", ");
        if let Some(name) = self.0.keys().find(|name| !lighting.groups.iter().any(|g| g.name == **name)) {
            return Err(Error::Group { name: name.clone(), groups: names() });
        }
        let mut weights = BTreeMap::new();
        for group in &mut lighting.groups {
            let weight = self.0.get(&group.name).copied().unwrap_or(1.0);
            let strength = group.factor.max_element();
            // What nobody makes brighter is as the scene has it.
            if weight > 1.0 && f64::from(strength) * f64::from(weight) > f64::from(BRIGHTEST) {
                let most = (BRIGHTEST / strength).max(1.0);
                return Err(Error::Factor { name: group.name.clone(), factor: weight, most });
            }
            group.factor *= weight;
            weights.insert(group.name.clone(), weight.into());
        }
        Ok(weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::groups::Group;
    use glam::Vec3;

    #[test]
    fn weights_are_read_whatever_the_names() {
        let mix: Mix = "sun=0.2, lamps = 1.5,Lamp, left=0,a=b=2".parse().unwrap();
        let weights: Vec<(&str, f32)> = mix.0.iter().map(|(name, f)| (name.as_str(), *f)).collect();
        assert_eq!(weights, [("Lamp, left", 0.0), ("a=b", 2.0), ("lamps", 1.5), ("sun", 0.2)]);
        assert_eq!(mix.and("moon=3".parse().unwrap()).unwrap().0.len(), 5);
    }

    #[test]
    fn what_is_no_weight_is_told() {
        for wrong in ["", "sun", "sun=1,moon", "=1", "sun=-1", "sun=inf", "sun=x", "sun=1,sun=2"] {
            assert!(wrong.parse::<Mix>().is_err(), "{wrong}");
        }
        let sun: Mix = "sun=1".parse().unwrap();
        assert_eq!(sun.clone().and(sun).unwrap_err(), MixError::Twice("sun".into()));
    }

    #[test]
    fn a_factor_that_no_light_of_a_scene_could_have_names_its_group() {
        let group = |name: &str, factor: f32| Group {
            name: name.into(),
            factor: Vec3::new(factor, 0.0, 1.0),
            ..Group::default()
        };
        let lighting = || Lighting { groups: vec![group("lamp", 50.0), group("off", 0.0)], ..Lighting::default() };
        let weigh = |mix: &str| mix.parse::<Mix>().unwrap().weigh(&mut lighting());
        for wrong in ["lamp=3e38", "lamp=2.1e18", "off=1.1e20"] {
            let error = weigh(wrong).unwrap_err();
            let (name, _) = wrong.split_once('=').unwrap();
            assert!(matches!(&error, Error::Factor { name: said, .. } if said == name), "{error}");
        }
        assert_eq!(weigh("lamp=1.9e18,off=0").unwrap()["lamp"], f64::from(1.9e18f32));
        let said = weigh("lmap=1").unwrap_err().to_string();
        assert!(said.contains("\"lmap\"") && said.ends_with("\"lamp\", \"off\""), "{said}");
    }
}
