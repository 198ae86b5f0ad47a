// What the agent of docs/unity.md uses of Unity and ML-Agents, with their names and signatures, and a scene of one such
// agent an area: the build's requests come in as lines, an area's answers go out as lines.

using System;
using System.Collections.Generic;
using System.Globalization;
using System.Linq;
using System.Reflection;
using Unity.MLAgents.Actuators;
using Unity.MLAgents.Sensors;
using UnityEngine;

namespace UnityEngine
{
    public struct Vector2
    {
        public float x, y;

        public Vector2(float x, float y) { this.x = x; this.y = y; }

        public static Vector2 zero { get { return new Vector2(0f, 0f); } }

        public float magnitude { get { return (float)Math.Sqrt(x * x + y * y); } }

        // Unity calls a vector shorter than 1e-5 zero.
        public Vector2 normalized { get { return magnitude > 1e-5f ? this / magnitude : zero; } }

        public static float Distance(Vector2 a, Vector2 b) { return (a - b).magnitude; }

        public static Vector2 MoveTowards(Vector2 current, Vector2 target, float maxDistanceDelta)
        {
            var way = target - current;
            return way.magnitude <= maxDistanceDelta ? target : current + way / way.magnitude * maxDistanceDelta;
        }

        public static Vector2 operator +(Vector2 a, Vector2 b) { return new Vector2(a.x + b.x, a.y + b.y); }
        public static Vector2 operator -(Vector2 a, Vector2 b) { return new Vector2(a.x - b.x, a.y - b.y); }
        public static Vector2 operator *(Vector2 a, float d) { return new Vector2(a.x * d, a.y * d); }
        public static Vector2 operator *(float d, Vector2 a) { return a * d; }
        public static Vector2 operator /(Vector2 a, float d) { return new Vector2(a.x / d, a.y / d); }
    }

    public struct Vector3
    {
        public float x, y, z;

        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
    }

    public static class Mathf
    {
        public static float Abs(float f) { return Math.Abs(f); }
        public static float Clamp(float value, float min, float max) { return Math.Max(min, Math.Min(max, value)); }
        public static float Exp(float power) { return (float)Math.Exp(power); }
        public static float Min(float a, float b) { return Math.Min(a, b); }
        public static float Sign(float f) { return f >= 0f ? 1f : -1f; }
    }

    public static class Random
    {
        static System.Random state = new System.Random();

        public static void InitState(int seed) { state = new System.Random(seed); }

        public static float Range(float minInclusive, float maxInclusive)
        {
            return minInclusive + (maxInclusive - minInclusive) * (float)state.NextDouble();
        }
    }

    public class Transform
    {
        public Vector3 localPosition { get; set; }
    }

    public class MonoBehaviour
    {
        public Transform transform { get; } = new Transform();
    }
}

namespace Unity.MLAgents.Actuators
{
    public struct ActionSegment<T>
    {
        readonly T[] array;

        public ActionSegment(T[] array) { this.array = array; }

        public T this[int index] { get { return array[index]; } }
    }

    public struct ActionBuffers
    {
        public ActionBuffers(float[] continuous) { ContinuousActions = new ActionSegment<float>(continuous); }

        public ActionSegment<float> ContinuousActions { get; }
    }
}

namespace Unity.MLAgents.Sensors
{
    public class VectorSensor
    {
        public readonly List<float> Observations = new List<float>();

        public void AddObservation(float observation) { Observations.Add(observation); }

        public void AddObservation(Vector2 observation)
        {
            Observations.Add(observation.x);
            Observations.Add(observation.y);
        }
    }
}

namespace Unity.MLAgents
{
    public enum StatAggregationMethod { Average = 0, MostRecent = 1, Sum = 2, Histogram = 3 }

    public sealed class EnvironmentParameters
    {
        public readonly Dictionary<string, float> Given = new Dictionary<string, float>();

        public float GetWithDefault(string key, float defaultValue)
        {
            float value;
            return Given.TryGetValue(key, out value) ? value : defaultValue;
        }
    }

    public sealed class StatsRecorder
    {
        public readonly List<KeyValuePair<string, float>> Added = new List<KeyValuePair<string, float>>();

        public void Add(
            string key, float value, StatAggregationMethod aggregationMethod = StatAggregationMethod.Average)
        {
            Added.Add(new KeyValuePair<string, float>(key, value));
        }
    }

    public class Academy
    {
        public static Academy Instance { get; } = new Academy();
        public EnvironmentParameters EnvironmentParameters { get; } = new EnvironmentParameters();
        public StatsRecorder StatsRecorder { get; } = new StatsRecorder();
    }

    public class Agent : MonoBehaviour
    {
        float reward;
        bool begun;
        float[] last;

        public virtual void OnEpisodeBegin() { }
        public virtual void CollectObservations(VectorSensor sensor) { }
        public virtual void OnActionReceived(ActionBuffers actions) { }

        public void AddReward(float increment) { reward += increment; }

        // As Unity does, in the middle of OnActionReceived: the last observation is taken and the next episode begins.
        public void EndEpisode()
        {
            last = See();
            OnEpisodeBegin();
            begun = true;
        }

        public float[] Begin()
        {
            if (!begun) OnEpisodeBegin();
            begun = false;
            return See();
        }

        // Whether the episode ended, the reward, and the observation.
        public IEnumerable<float> Act(float[] action)
        {
            last = null;
            reward = 0f;
            OnActionReceived(new ActionBuffers(action));
            return new[] { last == null ? 0f : 1f, reward }.Concat(last ?? See());
        }

        float[] See()
        {
            var sensor = new VectorSensor();
            CollectObservations(sensor);
            return sensor.Observations.ToArray();
        }
    }
}

// Lines in: "area begin" or "area step x z", then names and values of environment parameters. Lines out: the numbers of
// Begin or Act, then names and values of the statistics that were added.
static class Scene
{
    static void Main(string[] arguments)
    {
        CultureInfo.CurrentCulture = CultureInfo.InvariantCulture;
        UnityEngine.Random.InitState(int.Parse(arguments[0]));
        var agents = new Dictionary<string, CorridorAgent>();
        var academy = Unity.MLAgents.Academy.Instance;
        string line;
        while ((line = Console.ReadLine()) != null)
        {
            var words = new Queue<string>(line.Split(' '));
            var area = words.Dequeue();
            if (!agents.ContainsKey(area)) agents[area] = Placed(new CorridorAgent());
            var step = words.Dequeue() == "step";
            var action = step ? new[] { float.Parse(words.Dequeue()), float.Parse(words.Dequeue()) } : null;
            while (words.Count > 0)
                academy.EnvironmentParameters.Given[words.Dequeue()] = float.Parse(words.Dequeue());
            var numbers = step ? agents[area].Act(action) : agents[area].Begin();
            var statistics = academy.StatsRecorder.Added.Select(each => each.Key.Replace(' ', '_') + " " + each.Value);
            Console.WriteLine(string.Join(" ", numbers.Select(each => each.ToString("R")).Concat(statistics)));
            academy.StatsRecorder.Added.Clear();
        }
    }

    // The Inspector's part: something in every public field.
    static CorridorAgent Placed(CorridorAgent agent)
    {
        foreach (FieldInfo field in typeof(CorridorAgent).GetFields())
            field.SetValue(agent, new Transform());
        return agent;
    }
}
