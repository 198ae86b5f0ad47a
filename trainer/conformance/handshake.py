"""How a connection begins."""

from corridor_server.protocol.messages import API_VERSION, OK
from corridor_server.protocol.trainer_messages import initialization, stopping
from trainer.conformance.suite import Conformance, agents

MAJOR, MINOR, _ = API_VERSION.split(".")


class Handshake(Conformance):
    """How a connection begins."""

    def test_the_first_message_is_the_initialization_output_with_status_200(self) -> None:
        with self.connected() as session:
            hello = session.trainer.receive()
            assert hello.header.status == OK, f"status {hello.header.status}"
            assert hello.unity_output.HasField("rl_initialization_output"), "no rl_initialization_output"

    def test_the_player_names_itself_and_its_versions(self) -> None:
        with self.connected() as session:
            said = session.trainer.receive().unity_output.rl_initialization_output
            assert said.name, "the name is empty"
            assert said.package_version, "the package version is empty"
            assert said.communication_version.split(".")[0] == MAJOR, f"version {said.communication_version!r}"

    def test_the_player_declares_the_base_capability(self) -> None:
        with self.connected() as session:
            said = session.trainer.receive().unity_output.rl_initialization_output
            assert said.capabilities.baseRLCapabilities, "baseRLCapabilities is false"

    def test_an_acknowledgement_with_status_200_follows(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            acknowledgement = session.trainer.ask(initialization())
            assert acknowledgement.header.status == OK, f"status {acknowledgement.header.status}"
            assert not agents(acknowledgement.unity_output), "it already holds agents"

    def test_a_trainer_with_another_minor_version_is_accepted(self) -> None:
        with self.connected() as session:
            session.trainer.handshake(version=f"{MAJOR}.{int(MINOR) - 1}.0")
            assert agents(session.reset()), "no agents after the reset"

    def test_a_trainer_with_another_major_version_is_refused_with_an_exit_code(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            answer = session.trainer.ask(initialization(version=f"{int(MAJOR) + 1}.0.0"))
            assert answer.header.status != OK, "the player goes on"
            session.trainer.reply(stopping())
            assert session.exit_code() != 0, "exit code 0"

    def test_a_status_other_than_200_in_the_handshake_ends_the_player_with_code_0(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            session.trainer.reply(stopping())
            assert session.exit_code() == 0, f"exit code {session.exit_code()}"

    def test_a_status_other_than_200_after_the_acknowledgement_ends_the_player_with_code_0(self) -> None:
        with self.connected() as session:
            session.trainer.handshake()
            session.trainer.reply(stopping())
            assert session.exit_code() == 0, f"exit code {session.exit_code()}"

    def test_every_behavior_is_introduced_in_the_message_that_has_its_first_agents(self) -> None:
        with self.playing() as session:
            behaviors = set(session.output.rl_output.agentInfos)
            assert behaviors, "no agents after the first reset"
            assert behaviors <= set(session.specs), f"not introduced: {sorted(behaviors - set(session.specs))}"

    def test_a_behaviors_action_spec_is_given_in_new_and_deprecated_fields(self) -> None:
        with self.playing() as session:
            for name, parameters in session.specs.items():
                spec = parameters.action_spec
                sizes = list(parameters.vector_action_size_deprecated)
                assert spec.num_continuous_actions + spec.num_discrete_actions > 0, f"{name} has no actions"
                assert len(spec.discrete_branch_sizes) == spec.num_discrete_actions, f"{name}'s branches don't add up"
                if not spec.num_discrete_actions:
                    assert sizes == [spec.num_continuous_actions], f"deprecated size {sizes}"
                    assert parameters.vector_action_space_type_deprecated == 1, "deprecated type is not continuous"

    def test_a_behavior_is_marked_as_training_and_its_name_has_a_team(self) -> None:
        with self.playing() as session:
            for name, parameters in session.specs.items():
                assert parameters.is_training, f"{name} is not marked as training"
                assert "?team=" in name, f"{name} has no team"

    def test_the_number_of_areas_is_the_trainers(self) -> None:
        with self.playing(num_areas=1) as session:
            alone = len(agents(session.output))
        with self.playing(num_areas=3) as session:
            assert len(agents(session.output)) == 3 * alone, f"{len(agents(session.output))} agents in 3 areas"
