use super::*;

const GOOD: &str = r#"{"version":1,"fps":60,"fov_deg":60,"keyframes":[
    {"t":0.0,"eye":[0,0,5],"target":[0,0,0],"up":[0,1,0]},
    {"t":1.0,"eye":[3,0,5],"target":[0,0,0],"up":[0,1,0],"fov_deg":30}]}"#;

fn parse(text: &str) -> Result<Flypath, String> {
    Flypath::parse(Path::new("p.json"), text.as_bytes()).map_err(|e| e.to_string())
}

#[test]
fn frames_run_from_the_first_to_the_last_keyframe() {
    let path = parse(GOOD).unwrap();
    assert_eq!(path.frames(), 61);
    assert_eq!(path.at(path.time(0)).eye, DVec3::new(0.0, 0.0, 5.0));
    assert_eq!((path.at(path.time(60)).eye, path.at(path.time(60)).fov_deg), (DVec3::new(3.0, 0.0, 5.0), 30.0));
    assert_eq!(parse(&GOOD.replace("\"fps\":60", "\"fps\":0.4")).unwrap().frames(), 1);
    assert_eq!(parse(&GOOD.replace("1.0,\"eye\"", "0.7,\"eye\"")).unwrap().frames(), 43);
}

#[test]
fn every_mistake_has_a_message_that_names_it() {
    let cases = [
        ("\"version\":1", "\"version\":2", "version 2"),
        ("\"version\":1,", "", "missing field `version`"),
        ("\"fps\":60", "\"fps\":0", "fps is 0"),
        ("\"fps\":60", "\"fps\":-1", "fps is -1"),
        ("\"fps\":60", "\"fps\":1e12", "at most 1000000"),
        ("\"fps\":60", "\"fsp\":60", "unknown field `fsp`"),
        ("\"t\":1.0", "\"t\":0.0", "times must increase"),
        ("\"t\":1.0", "\"t\":1e999", "number out of range"),
        ("\"t\":1.0", "\"t\":NaN", "p.json:3: expected value"),
        ("[0,0,5]", "[0,0]", "p.json:2: invalid length 2"),
        ("[0,0,5]", "[0,0,0]", "keyframe 0 (t = 0): eye and target"),
        ("[0,1,0]},", "[0,0,0]},", "up is the zero vector"),
        ("[0,1,0]},", "[0,0,2]},", "up is parallel"),
        ("\"fov_deg\":30", "\"fov_deg\":180", "keyframe 1 (t = 1): fov_deg is 180"),
        ("\"fov_deg\":60", "\"fov_deg\":0", "fov_deg is 0"),
        ("[3,0,5]", "[0,0,-15]", "frame "),
        ("}]}", "}]", "p.json:3: EOF"),
    ];
    for (from, to, expected) in cases {
        assert!(GOOD.contains(from), "{from}");
        let message = parse(&GOOD.replace(from, to)).expect_err(to);
        assert!(message.contains(expected), "{to}: {message}");
    }
    let none = r#"{"version":1,"fps":60,"fov_deg":60,"keyframes":[]}"#;
    assert!(parse(none).unwrap_err().contains("no keyframes"));
    assert!(parse("").unwrap_err().contains("p.json:1: EOF"));
}

#[test]
fn speed_does_not_jump_at_a_keyframe() {
    let key = |t: f64, x: f64| Keyframe {
        t,
        eye: DVec3::new(x, x * x, 5.0),
        target: DVec3::ZERO,
        up: DVec3::Y,
        fov_deg: 60.0,
    };
    let path = Flypath::new(60.0, vec![key(0.0, 0.0), key(1.0, 2.0), key(1.5, 1.0), key(4.0, 3.0)]).unwrap();
    for t in [1.0, 1.5] {
        let h = 1e-5;
        let before = (path.at(t).eye - path.at(t - h).eye) / h;
        let after = (path.at(t + h).eye - path.at(t).eye) / h;
        assert!((before - after).length() < 1e-3, "{before} {after}");
    }
}

#[test]
fn a_written_flight_reads_back_the_same() {
    let flight = default_flight(DVec3::new(5e5, 4.5e6, 10.0), 3.0, DVec3::Z, 50.0);
    let file = tempfile::NamedTempFile::new().unwrap();
    flight.write(file.path()).unwrap();
    assert_eq!(Flypath::open(file.path()).unwrap(), flight);
    assert_eq!(flight.frames(), 301);
}
