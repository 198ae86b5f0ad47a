"""How a connection begins."""

from typing import Any

from corridor_server.protocol.messages import API_VERSION, OK, PNG
from corridor_server.protocol.trainer_messages import initialization, stopping
from trainer.conformance.session import VARIABLE_SIZE, Session, agents, pictures
from trainer.conformance.suite import Conformance, needs, strict
from trainer.conformance.verdicts import NotApplicable, expect, expect_equal

MAJOR, MINOR, _ = API_VERSION.split(".")
DISCRETE, CONTINUOUS = 0, 1  # SpaceTypeProto
HYBRID_ACTIONS = "hybridActions"


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

    @needs("hybrid action spec, group, buffer or channel mapping")
    def test_what_the_player_sends_beyond_the_base_it_declares(self) -> None:
        with self.connected() as session:
            declared = session.trainer.handshake().unity_output.rl_initialization_output.capabilities
            session.reset()
            for name in sorted(_capabilities_used(session)):
                expect(getattr(declared, name), f"it sends what needs {name}, which is not declared", "a declaration")

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

    def test_every_behavior_is_introduced_in_the_message_that_has_its_first_agents(self) -> None:
        with self.playing(num_areas=2) as session:
            for number, output in enumerate(session.play(200)):
                for behavior in output.rl_output.agentInfos:
                    came = f"message {number + 1} has agents of {behavior}, which was not introduced"
                    expect(behavior in session.specs, came, "an introduction in it or before")

    def test_a_behaviors_action_spec_has_a_size_for_each_branch(self) -> None:
        with self.playing() as session:
            for name, parameters in _introduced(session).items():
                spec = parameters.action_spec
                sizes = list(spec.discrete_branch_sizes)
                expect_equal(len(sizes), spec.num_discrete_actions, f"{name}'s number of discrete branch sizes is")
                expect(all(size >= 1 for size in sizes), f"{name}'s branches have {sizes} choices", "at least 1")

    def test_a_trainer_with_hybrid_actions_gets_no_deprecated_sizes(self) -> None:
        with self.playing() as session:
            for name, parameters in _introduced(session).items():
                sizes = list(parameters.vector_action_size_deprecated)
                expect(not sizes, f"{name} has deprecated sizes {sizes} too", "the action spec alone")

    def test_a_trainer_without_hybrid_actions_gets_deprecated_sizes_too(self) -> None:
        with self.playing() as session:
            for name, parameters in _introduced(session).items():
                if parameters.action_spec.num_continuous_actions and parameters.action_spec.num_discrete_actions:
                    raise NotApplicable(f"{name} is hybrid, which such a trainer can't play")
        with self.connected() as session:
            session.trainer.receive()
            session.trainer.ask(initialization(without=[HYBRID_ACTIONS]))
            session.reset()
            for name, parameters in session.specs.items():
                spec = parameters.action_spec
                kind = CONTINUOUS if spec.num_continuous_actions else DISCRETE
                sizes = [spec.num_continuous_actions] if kind == CONTINUOUS else list(spec.discrete_branch_sizes)
                expect_equal(list(parameters.vector_action_size_deprecated), sizes, f"{name}'s deprecated sizes are")
                came = parameters.vector_action_space_type_deprecated
                expect_equal(came, kind, f"{name}'s deprecated type is")

    def test_a_behavior_is_marked_as_training_and_its_name_has_a_team(self) -> None:
        with self.playing() as session:
            for name, parameters in _introduced(session).items():
                expect(parameters.is_training, f"{name} is not marked as training", "the mark")
                team = name.partition("?team=")[2]
                expect(team.isdigit(), f"{name} has no team", "a number after ?team=")

    @strict
    def test_all_seven_capabilities_are_declared(self) -> None:
        with self.connected() as session:
            declared = session.trainer.receive().unity_output.rl_initialization_output.capabilities
            for name in declared.DESCRIPTOR.fields_by_name:
                expect(getattr(declared, name), f"{name} is not declared", "a declaration")

    @strict
    def test_a_trainer_with_another_major_version_is_refused_with_an_exit_code(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            answer = session.trainer.ask(initialization(version=f"{int(MAJOR) + 1}.0.0"))
            expect(answer.header.status != OK, "the player goes on with status 200", "another one")
            session.trainer.reply(stopping())
            expect(session.exit_code() != 0, "exit code 0", "another one")

    @strict
    def test_a_status_other_than_200_in_the_handshake_ends_the_player_with_code_0(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            session.trainer.reply(stopping())
            expect_equal(session.exit_code(), 0, "exit code")

    @strict
    def test_a_status_other_than_200_after_the_acknowledgement_ends_the_player_with_code_0(self) -> None:
        with self.connected() as session:
            session.trainer.handshake()
            session.trainer.reply(stopping())
            expect_equal(session.exit_code(), 0, "exit code")

    @strict
    def test_the_number_of_areas_is_the_trainers(self) -> None:
        with self.playing(num_areas=1) as session:
            alone = len(agents(session.output))
        with self.playing(num_areas=3) as session:
            expect_equal(len(agents(session.output)), 3 * alone, "the number of agents in 3 areas is")


def _introduced(session: Session) -> dict[str, Any]:
    """Behavior -> its parameters, those that come late included."""
    for _ in session.play(100):
        pass
    return session.specs


def _capabilities_used(session: Session) -> set[str]:
    """The capabilities without which a trainer could not read what the player sends."""
    used = set()
    for output in session.play(100):
        for info in agents(output):
            if info.group_id:
                used.add("multiAgentGroups")
            for each in info.observations:
                if VARIABLE_SIZE in each.dimension_properties:
                    used.add("variableLengthObservation")
                if each.compression_type == PNG and len(pictures(each.compressed_data)) > 1:
                    used.add("concatenatedPngObservations")
                if each.compressed_channel_mapping:
                    used.add("compressedChannelMapping")
    for parameters in session.specs.values():
        if parameters.action_spec.num_continuous_actions and parameters.action_spec.num_discrete_actions:
            used.add(HYBRID_ACTIONS)
    return used
