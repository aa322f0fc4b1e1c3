#!/usr/bin/env escript
%% The same workloads in Erlang: escript erlang_peer.escript tell|ask|restart [short]. One JSON line.
-module(erlang_peer).
-mode(compile).
-behaviour(gen_server).
-export([main/1, init/1, handle_call/3, handle_cast/2, start_named/0]).

main(["tell" | More]) -> say([{"tell_per_s", tell(amount(More, 400000, 2000000))}]);
main(["ask" | More]) -> say(spans("ask", asks(amount(More, 20000, 100000))));
main(["restart" | More]) -> say(spans("restart", restarts(amount(More, 200, 2000)))).

amount(["short"], Short, _) -> Short;
amount([], _, Long) -> Long.

state() -> {state, 1, 2, <<"arm/left">>, {0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1},
            {0.2, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2}, {0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3}}.

%% A gen_server, as users write them; then one call, which is answered after all casts.
init(counter) -> {ok, 0};
init({supervisor, N}) ->
    {ok, {{one_for_one, N + 1, 5}, [{named, {?MODULE, start_named, []}, permanent, 1000, worker, [?MODULE]}]}}.
handle_call(count, _, N) -> {reply, N, N}.
handle_cast({state, _, _, _, _, _, _}, N) -> {noreply, N + 1}.

tell(N) ->
    {ok, Pid} = gen_server:start(?MODULE, counter, []),
    Began = erlang:monotonic_time(nanosecond),
    told(Pid, state(), N),
    N = gen_server:call(Pid, count, 60000),
    N / ((erlang:monotonic_time(nanosecond) - Began) / 1.0e9).

told(_, _, 0) -> ok;
told(Pid, State, N) -> gen_server:cast(Pid, State), told(Pid, State, N - 1).

asks(N) ->
    {ok, Pid} = gen_server:start(?MODULE, counter, []),
    [gen_server:call(Pid, count, 1000) || _ <- lists:seq(1, 1000)],
    [span(fun() -> gen_server:call(Pid, count, 1000) end) || _ <- lists:seq(1, N)].

span(What) ->
    Began = erlang:monotonic_time(nanosecond),
    What(),
    erlang:monotonic_time(nanosecond) - Began.

%% From the order to die until the new incarnation, started by its supervisor, has answered.
start_named() -> gen_server:start_link({local, named}, ?MODULE, counter, []).

restarts(N) ->
    logger:set_primary_config(level, none),
    {ok, Supervisor} = supervisor:start_link(?MODULE, {supervisor, N}),
    Spans = [span(fun() -> exit(whereis(named), kill), answered() end) || _ <- lists:seq(1, N)],
    unlink(Supervisor),
    Spans.

answered() ->
    try gen_server:call(named, count, 1000)
    catch exit:_ -> answered()
    end.

spans(Name, Spans) ->
    Ordered = list_to_tuple(lists:sort(Spans)),
    N = tuple_size(Ordered),
    [{Name ++ "_p50_us", element(N div 2 + 1, Ordered) / 1.0e3},
     {Name ++ "_p99_us", element(min(N, N * 99 div 100 + 1), Ordered) / 1.0e3}].

say(Figures) ->
    io:format("{~s}~n", [lists:join(", ", [io_lib:format("\"~s\": ~p", [Name, Value]) || {Name, Value} <- Figures])]).
