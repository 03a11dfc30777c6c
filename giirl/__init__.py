"""The shared vocabulary of GIIRL: values, configuration, wire, language, nets and the command."""
