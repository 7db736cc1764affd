// A thousand fish swim to a place each, in C#; the library is made of fish_library.c.
using System;
using System.Runtime.InteropServices;

internal static class Fish
{
    public const int State = 150;
    public const int Latent = 112;
    public const int Control = 12;
    public const int Nose = 0;
    public const int TailUp = 63;
    public const float PhasePerStep = 1.25663706f;

    [DllImport("fish", CallingConvention = CallingConvention.Cdecl)]
    private static extern void fish_encode([In] float[] state, [Out] float[] latent);

    [DllImport("fish", CallingConvention = CallingConvention.Cdecl)]
    private static extern void fish_advance_batch(
        [In, Out] float[] latents, [In] float[] controls, int count, [Out] float[] states);

    [DllImport("fish", CallingConvention = CallingConvention.Cdecl)]
    private static extern void swim_control(
        [In] float[] state, float phase, [In] float[] command, [Out] float[] control);

    public static void Encode(float[] state, float[] latent) => fish_encode(state, latent);

    public static void AdvanceBatch(float[] latents, float[] controls, int count, float[] states) =>
        fish_advance_batch(latents, controls, count, states);

    public static void Swim(float[] state, float phase, float[] command, float[] control) =>
        swim_control(state, phase, command, control);
}

internal static class School
{
    private const int Count = 1000;
    private const int SuperSteps = 100;

    // How far the fish still has to turn left to swim to (x, y) [rad].
    private static float TurnTo(float[] fish, double x, double y)
    {
        double aheadX = fish[Fish.Nose] - fish[Fish.TailUp];
        double aheadY = fish[Fish.Nose + 1] - fish[Fish.TailUp + 1];
        double toX = x - fish[Fish.Nose];
        double toY = y - fish[Fish.Nose + 1];
        return (float)Math.Atan2(aheadX * toY - aheadY * toX, aheadX * toX + aheadY * toY);
    }

    // The state at rest: `rest` under `facts` in fish.vectors.json.
    private static float[] ReadRest(string path)
    {
        using var document = System.Text.Json.JsonDocument.Parse(System.IO.File.ReadAllText(path));
        var numbers = document.RootElement.GetProperty("facts").GetProperty("rest");
        var rest = new float[numbers.GetArrayLength()];
        for (int i = 0; i < rest.Length; i++)
        {
            rest[i] = numbers[i].GetSingle();
        }
        return rest;
    }

    private static void Main()
    {
        float[] rest = ReadRest("fish.vectors.json");
        var latent = new float[Fish.Latent];
        Fish.Encode(rest, latent);
        var states = new float[Count * Fish.State];
        var latents = new float[Count * Fish.Latent];
        var controls = new float[Count * Fish.Control];
        for (int i = 0; i < Count; i++)
        {
            rest.CopyTo(states, i * Fish.State);
            latent.CopyTo(latents, i * Fish.Latent);
        }

        var state = new float[Fish.State];
        var control = new float[Fish.Control];
        for (int step = 0; step < SuperSteps; step++)
        {
            for (int i = 0; i < Count; i++)
            {
                Array.Copy(states, i * Fish.State, state, 0, Fish.State);
                float[] command = { 0.14f, TurnTo(state, Math.Cos(i), Math.Sin(i)), 0.0f, 0.0f };
                Fish.Swim(state, step * Fish.PhasePerStep, command, control);
                control.CopyTo(controls, i * Fish.Control);
            }
            Fish.AdvanceBatch(latents, controls, Count, states);
        }
        Console.WriteLine($"the first fish is at {states[Fish.Nose]:F3}, {states[Fish.Nose + 1]:F3} m");
    }
}
