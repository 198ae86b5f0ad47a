"""How a connection begins."""

from corridor_server.protocol.messages import API_VERSION, OK
from corridor_server.protocol.trainer_messages import initialization, stopping
from trainer.conformance.suite import Conformance, agents, expect, expect_equal

MAJOR, MINOR, _ = API_VERSION.split(".")
CONTINUOUS = 1  # SpaceTypeProto


class Handshake(Conformance):
    """How a connection begins."""

    def test_the_first_message_is_the_initialization_output_with_status_200(self) -> None:
        with self.connected() as session:
            hello = session.trainer.receive()
            expect_equal(hello.header.status, OK, "status")
            introduced = hello.unity_output.HasField("rl_initialization_output")
            expect(introduced, "no rl_initialization_output", "one")

    def test_the_player_names_itself_and_its_versions(self) -> None:
        with self.connected() as session:
            said = session.trainer.receive().unity_output.rl_initialization_output
            expect(said.name, "the name is empty", "any other")
            expect(said.package_version, "the package version is empty", "any other")
            version = said.communication_version
            expect(version.split(".")[0] == MAJOR, f"version {version!r}", f"{MAJOR}.x.y")

    def test_the_player_declares_the_base_capability(self) -> None:
        with self.connected() as session:
            said = session.trainer.receive().unity_output.rl_initialization_output
            expect(said.capabilities.baseRLCapabilities, "baseRLCapabilities is false", "true")

    def test_an_acknowledgement_with_status_200_follows(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            acknowledgement = session.trainer.ask(initialization())
            expect_equal(acknowledgement.header.status, OK, "status")
            expect(not agents(acknowledgement.unity_output), "it already holds agents", "an empty one")

    def test_a_trainer_with_another_minor_version_is_accepted(self) -> None:
        with self.connected() as session:
            session.trainer.handshake(version=f"{MAJOR}.{int(MINOR) - 1}.0")
            expect(agents(session.reset()), "no agents after the reset", "at least one")

    def test_a_trainer_with_another_major_version_is_refused_with_an_exit_code(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            answer = session.trainer.ask(initialization(version=f"{int(MAJOR) + 1}.0.0"))
            expect(answer.header.status != OK, "the player goes on with status 200", "another one")
            session.trainer.reply(stopping())
            expect(session.exit_code() != 0, "exit code 0", "another one")

    def test_a_status_other_than_200_in_the_handshake_ends_the_player_with_code_0(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            session.trainer.reply(stopping())
            expect_equal(session.exit_code(), 0, "exit code")

    def test_a_status_other_than_200_after_the_acknowledgement_ends_the_player_with_code_0(self) -> None:
        with self.connected() as session:
            session.trainer.handshake()
            session.trainer.reply(stopping())
            expect_equal(session.exit_code(), 0, "exit code")

    def test_every_behavior_is_introduced_in_the_message_that_has_its_first_agents(self) -> None:
        with self.playing() as session:
            behaviors = set(session.output.rl_output.agentInfos)
            expect(behaviors, "no agents after the first reset", "at least one")
            unknown = sorted(behaviors - set(session.specs))
            expect(not unknown, f"not introduced: {unknown}", "an introduction in the same message")

    def test_a_behaviors_action_spec_is_given_in_new_and_deprecated_fields(self) -> None:
        with self.playing() as session:
            for name, parameters in session.specs.items():
                spec = parameters.action_spec
                sizes = list(parameters.vector_action_size_deprecated)
                actions = spec.num_continuous_actions + spec.num_discrete_actions
                expect(actions > 0, f"{name} has no actions", "at least one")
                branches = len(spec.discrete_branch_sizes)
                expect_equal(branches, spec.num_discrete_actions, f"{name}'s number of discrete branch sizes is")
                if not spec.num_discrete_actions:
                    expect_equal(sizes, [spec.num_continuous_actions], "deprecated size")
                    kind = parameters.vector_action_space_type_deprecated
                    expect(kind == CONTINUOUS, f"deprecated type {kind}", f"continuous, {CONTINUOUS},")

    def test_a_behavior_is_marked_as_training_and_its_name_has_a_team(self) -> None:
        with self.playing() as session:
            for name, parameters in session.specs.items():
                expect(parameters.is_training, f"{name} is not marked as training", "the mark")
                expect("?team=" in name, f"{name} has no team", "one after ?team=")

    def test_the_number_of_areas_is_the_trainers(self) -> None:
        with self.playing(num_areas=1) as session:
            alone = len(agents(session.output))
        with self.playing(num_areas=3) as session:
            expect_equal(len(agents(session.output)), 3 * alone, "the number of agents in 3 areas is")
