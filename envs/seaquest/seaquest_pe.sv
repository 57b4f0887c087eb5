// The core of Seaquest: step.py in hardware. Pipelined, a slot a cycle.
//
// The lists are planes of bits here as there, so what the golden step does to all places with one
// instruction is one gate a place. The order of the stages is the order of play. A slot that is held
// goes through them all; `go` is low for it, and every stage leaves it as it is.

// verilator lint_off DECLFILENAME
package seaquest_pkg;
  // verilator lint_on DECLFILENAME

  // Cycles from an input to its result, and from one input to the next.
  localparam int unsigned LATENCY = 9;
  localparam int unsigned II = 1;

  localparam int unsigned STATE_BITS = 694;
  localparam int unsigned ACTION_BITS = 3;
  localparam int unsigned OBS_BITS = 440;
  localparam int unsigned REWARD_BITS = 4;

  // Places of the conveyors, which step.py explains, between steps and within one.
  localparam int unsigned ENEMIES = 29;
  localparam int unsigned ENEMY_PLACES = ENEMIES + 1;
  localparam int unsigned BULLETS = 12;
  localparam int unsigned BULLET_PLACES = BULLETS + 2;

  typedef logic [ENEMY_PLACES-1:0] enemy_plane_t;
  typedef logic [BULLET_PLACES-1:0] bullet_plane_t;

  // A bullet of the submarine.
  typedef struct packed {
    logic       alive;
    logic       rightward;
    logic [3:0] y;
    logic [3:0] column;
  } bullet_t;

  // Rows of divers, enemies and hostile bullets count from the first below the surface.
  typedef struct packed {
    logic       alive;
    logic       rightward;
    logic [2:0] row;
    logic [3:0] column;
  } diver_t;

  // All of the state but its planes.
  typedef struct packed {
    diver_t             diver_1;
    diver_t             diver_0;
    bullet_t            bullet_1;
    bullet_t            bullet_0;
    logic [4:0]         ramp;
    logic [4:0]         diver_timer;
    logic [4:0]         enemy_timer;
    logic [2:0]         reload;
    logic signed [15:0] divers;
    logic [7:0]         oxygen;
    logic               surfaced;
    logic               facing_right;
    logic [3:0]         y;
    logic [3:0]         x;
    logic [2:0]         last_action;
  } scalars_t;

  // A state word, the first field of the spec last.
  typedef struct packed {
    logic [3:0][BULLETS-1:0] hostile_column;
    logic [2:0][BULLETS-1:0] hostile_row;
    logic [BULLETS-1:0]      hostile_rightward;
    logic [BULLETS-1:0]      hostile_alive;
    logic [3:0][ENEMIES-1:0] enemy_fire;
    logic [2:0][ENEMIES-1:0] enemy_move;
    logic [3:0][ENEMIES-1:0] enemy_column;
    logic [2:0][ENEMIES-1:0] enemy_row;
    logic [ENEMIES-1:0]      enemy_rightward;
    logic [ENEMIES-1:0]      enemy_submarine;
    logic [ENEMIES-1:0]      enemy_alive;
    scalars_t                scalars;
  } state_t;

  // An observation word, likewise.
  typedef struct packed {
    logic [3:0][BULLETS-1:0] hostile_column;
    logic [2:0][BULLETS-1:0] hostile_row;
    logic [BULLETS-1:0]      hostile_alive;
    logic [3:0][ENEMIES-1:0] enemy_column;
    logic [2:0][ENEMIES-1:0] enemy_row;
    logic [ENEMIES-1:0]      enemy_rightward;
    logic [ENEMIES-1:0]      enemy_submarine;
    logic [ENEMIES-1:0]      enemy_alive;
    diver_t                  diver_1;
    diver_t                  diver_0;
    bullet_t                 bullet_1;
    bullet_t                 bullet_0;
    logic [2:0]              aboard;
    logic [3:0]              oxygen_bar;
    logic                    facing_right;
    logic [3:0]              y;
    logic [3:0]              x;
  } observation_t;

  // What becomes of a diver.
  typedef struct packed {
    diver_t diver;
    logic   aboard;
  } boarding_t;

  // Planes within a step.
  typedef struct packed {
    logic [3:0][ENEMY_PLACES-1:0] fire;
    logic [2:0][ENEMY_PLACES-1:0] move;
    logic [3:0][ENEMY_PLACES-1:0] column;
    logic [2:0][ENEMY_PLACES-1:0] row;
    enemy_plane_t                 rightward;
    enemy_plane_t                 submarine;
    enemy_plane_t                 alive;
  } enemies_t;

  typedef struct packed {
    logic [3:0][BULLET_PLACES-1:0] column;
    logic [2:0][BULLET_PLACES-1:0] row;
    bullet_plane_t                 rightward;
    bullet_plane_t                 alive;
  } hostile_t;

  // What goes from stage to stage.
  typedef struct packed {
    enemies_t   enemies;
    hostile_t   hostile;
    scalars_t   scalars;
    logic       go;
    // An enemy has come into the topmost place.
    logic       appeared;
    // What own bullets have struck so far, and whether anything has struck the submarine.
    logic [1:0] struck;
    logic       terminated;
  } flow_t;

endpackage

module seaquest_pe
  import seaquest_pkg::*;
#(
    // The last action is repeated where the lower 28 bits of the second draw are below this.
    parameter int unsigned STICKY_BELOW = 26843546,
    // Whether surfacing makes enemies faster and more frequent.
    parameter bit DIFFICULTY_RAMPING = 1'b1
) (
    input logic               clk_i,
    input logic               rst_ni,
    input logic               valid_i,
    // Start from the initial state, not from state_i.
    input logic               first_i,
    // Do not step: the result is the state started from and its observation.
    input logic               hold_i,
    input state_t             state_i,
    input logic   [2:0]       action_i,
    // An enemy and a diver that may appear; the second says, too, whether the last action is repeated.
    input logic   [1:0][31:0] rng_i,

    output logic               valid_o,
    output state_t             state_o,
    output observation_t       obs_o,
    output logic         [3:0] reward_o,
    output logic               terminated_o
);

  localparam logic [2:0] LEFT = 3'd1;
  localparam logic [2:0] UP = 3'd2;
  localparam logic [2:0] RIGHT = 3'd3;
  localparam logic [2:0] DOWN = 3'd4;
  localparam logic [2:0] FIRE = 3'd5;
  localparam logic [3:0] LAST_COLUMN = 4'd9;
  localparam logic [3:0] DEEPEST = 4'd8;
  localparam logic [7:0] MAX_OXYGEN = 8'd200;
  localparam logic signed [15:0] MAX_DIVERS = 16'sd6;
  localparam logic signed [15:0] LEAST_DIVERS = -16'sd32768;
  localparam logic [4:0] SLOWEST_SPAWN = 5'd20;
  localparam logic [4:0] DIVER_SPAWN = 5'd30;
  localparam logic [2:0] SLOWEST_MOVE = 3'd5;
  localparam logic [3:0] FIRE_INTERVAL = 4'd10;
  localparam logic [2:0] RELOAD_STEPS = 3'd5;
  localparam logic [4:0] LAST_RAMP = 5'd19;
  // The least 28-bit number that is not below a third.
  localparam logic [27:0] THIRD = 28'd89478486;
  // By the diver timer, which is counted down already, whether the divers have moved.
  localparam logic [31:0] DIVERS_MOVED = 32'h0104_1041;

  localparam state_t START = '{
      scalars: '{
          x: 4'd5,
          oxygen: MAX_OXYGEN,
          surfaced: 1'b1,
          enemy_timer: SLOWEST_SPAWN,
          diver_timer: DIVER_SPAWN,
          default: '0
      },
      default: '0
  };

  // The steps of a move less one: 5, after six ramps 2.
  function automatic logic [2:0] move_interval(input logic [4:0] ramp);
    return SLOWEST_MOVE - (ramp >= 5'd6 ? 3'd3 : {1'b0, ramp[2:1]});
  endfunction

  function automatic logic [3:0] moved_column(input logic [3:0] column, input logic rightward,
                                              input logic moves);
    return column + {3'b000, moves & rightward} - {3'b000, moves & ~rightward};
  endfunction

  // The places in a row of the board.
  function automatic enemy_plane_t in_row(input logic [2:0][ENEMY_PLACES-1:0] row, input logic [3:0] y);
    logic [3:0] wanted;
    wanted = y - 4'd1;
    return ~((row[0] ^ {ENEMY_PLACES{wanted[0]}}) | (row[1] ^ {ENEMY_PLACES{wanted[1]}}) |
             (row[2] ^ {ENEMY_PLACES{wanted[2]}})) & ~{ENEMY_PLACES{wanted[3]}};
  endfunction

  function automatic enemy_plane_t in_column(input logic [3:0][ENEMY_PLACES-1:0] column, input logic [3:0] x);
    return ~((column[0] ^ {ENEMY_PLACES{x[0]}}) | (column[1] ^ {ENEMY_PLACES{x[1]}}) |
             (column[2] ^ {ENEMY_PLACES{x[2]}}) | (column[3] ^ {ENEMY_PLACES{x[3]}}));
  endfunction

  function automatic bullet_plane_t hostile_in_row(input logic [2:0][BULLET_PLACES-1:0] row,
                                                   input logic [3:0] y);
    logic [3:0] wanted;
    wanted = y - 4'd1;
    return ~((row[0] ^ {BULLET_PLACES{wanted[0]}}) | (row[1] ^ {BULLET_PLACES{wanted[1]}}) |
             (row[2] ^ {BULLET_PLACES{wanted[2]}})) & ~{BULLET_PLACES{wanted[3]}};
  endfunction

  function automatic bullet_plane_t hostile_in_column(input logic [3:0][BULLET_PLACES-1:0] column,
                                                      input logic [3:0] x);
    return ~((column[0] ^ {BULLET_PLACES{x[0]}}) | (column[1] ^ {BULLET_PLACES{x[1]}}) |
             (column[2] ^ {BULLET_PLACES{x[2]}}) | (column[3] ^ {BULLET_PLACES{x[3]}}));
  endfunction

  // The first of a list.
  function automatic enemy_plane_t lowest(input enemy_plane_t plane);
    return plane & (~plane + 1'b1);
  endfunction

  // What a bullet strikes of the enemies there: the first fish, else the first submarine.
  function automatic enemy_plane_t first_struck(input enemy_plane_t alive, input enemy_plane_t submarine,
                                                input enemy_plane_t there);
    enemy_plane_t fish;
    fish = there & alive & ~submarine;
    return lowest(fish | (there & alive & {ENEMY_PLACES{fish == '0}}));
  endfunction

  // One diver comes aboard or moves.
  function automatic boarding_t boarding(input diver_t diver, input logic [3:0] x, input logic [3:0] y,
                                         input logic room, input logic moves, input logic go);
    logic [3:0] wanted;
    logic beside;
    wanted = y - 4'd1;
    beside = go & room & diver.alive & {1'b0, diver.row} == wanted;
    boarding.diver = diver;
    boarding.diver.column =
        moved_column(diver.column, diver.rightward, go & moves & ~(beside & diver.column == x));
    boarding.aboard = beside & boarding.diver.column == x;
    boarding.diver.alive = diver.alive & ~(boarding.aboard | go & boarding.diver.column > LAST_COLUMN);
  endfunction

  // An own bullet moves.
  function automatic bullet_t flown(input bullet_t bullet, input logic go);
    flown = bullet;
    flown.column = moved_column(bullet.column, bullet.rightward, go);
    flown.alive = bullet.alive & ~(go & flown.column > LAST_COLUMN);
  endfunction

  // First stage: where the slot starts from, and what it does.
  state_t from_q;
  logic [2:0] action_d, action_q;
  logic go_q;
  logic enemy_rightward_q, enemy_kind_q, diver_rightward_q;
  logic [2:0] enemy_row_q, diver_row_q;
  state_t from_d;
  logic   sticky;

  assign from_d   = first_i ? START : state_i;
  assign sticky   = {1'b0, rng_i[1][27:0]} < 29'(STICKY_BELOW);
  // A slot that is held keeps its last action, which is what it is left with after a sticky step.
  assign action_d = sticky || hold_i ? from_d.scalars.last_action : action_i;

  always_ff @(posedge clk_i) begin
    from_q            <= from_d;
    action_q          <= action_d;
    go_q              <= !hold_i;
    enemy_rightward_q <= rng_i[0][31];
    enemy_row_q       <= rng_i[0][30:28];
    enemy_kind_q      <= rng_i[0][27:0] < THIRD;
    diver_rightward_q <= rng_i[1][31];
    diver_row_q       <= rng_i[1][30:28];
  end

  // Second stage: enemies and divers appear, the action is done.
  flow_t acted_d, acted_q;
  scalars_t from;
  enemy_plane_t opposed;
  logic enemy_due, diver_due, fires, left, right, up, down;
  logic [4:0] spawn_interval;
  logic [2:0] interval;

  assign from = from_q.scalars;
  assign enemy_due = go_q & from.enemy_timer == '0;
  assign diver_due = go_q & from.diver_timer == '0;
  assign spawn_interval = SLOWEST_SPAWN - (from.ramp >= LAST_RAMP ? LAST_RAMP : from.ramp);
  assign interval = move_interval(from.ramp);
  assign fires = go_q & action_q == FIRE & from.reload == '0;
  assign left = go_q & action_q == LEFT;
  assign right = go_q & action_q == RIGHT;
  assign up = go_q & action_q == UP & from.y != '0;
  assign down = go_q & action_q == DOWN & from.y < DEEPEST;
  // Not where its row has one that swims the other way.
  assign opposed = in_row(
      acted_d.enemies.row, {1'b0, enemy_row_q} + 4'd1
  ) & {1'b0, from_q.enemy_alive} & (acted_d.enemies.rightward ^ {ENEMY_PLACES{enemy_rightward_q}});

  always_comb begin
    acted_d.enemies.submarine = {enemy_kind_q, from_q.enemy_submarine};
    acted_d.enemies.rightward = {enemy_rightward_q, from_q.enemy_rightward};
    acted_d.hostile.alive = {2'b00, from_q.hostile_alive};
    acted_d.hostile.rightward = {2'b00, from_q.hostile_rightward};
    for (int unsigned k = 0; k < 3; k++) begin
      acted_d.enemies.row[k]  = {enemy_row_q[k], from_q.enemy_row[k]};
      acted_d.enemies.move[k] = {interval[k], from_q.enemy_move[k]};
      acted_d.hostile.row[k]  = {2'b00, from_q.hostile_row[k]};
    end
    for (int unsigned k = 0; k < 4; k++) begin
      acted_d.enemies.column[k] = {LAST_COLUMN[k] & ~enemy_rightward_q, from_q.enemy_column[k]};
      acted_d.enemies.fire[k]   = {FIRE_INTERVAL[k], from_q.enemy_fire[k]};
      acted_d.hostile.column[k] = {2'b00, from_q.hostile_column[k]};
    end
    acted_d.appeared = enemy_due & opposed == '0;
    acted_d.enemies.alive = {acted_d.appeared, from_q.enemy_alive};
    acted_d.go = go_q;
    acted_d.struck = '0;
    acted_d.terminated = 1'b0;

    acted_d.scalars = from;
    acted_d.scalars.last_action = action_q;
    acted_d.scalars.enemy_timer = (enemy_due ? spawn_interval : from.enemy_timer) - {4'd0, go_q};
    acted_d.scalars.diver_timer = (diver_due ? DIVER_SPAWN : from.diver_timer) - {4'd0, go_q};
    if (diver_due) begin
      acted_d.scalars.diver_0 = from.diver_1;
      acted_d.scalars.diver_1 = '{
          alive: 1'b1,
          rightward: diver_rightward_q,
          row: diver_row_q,
          column: LAST_COLUMN & ~{4{diver_rightward_q}}
      };
    end
    if (fires) begin
      acted_d.scalars.bullet_0 = from.bullet_1;
      acted_d.scalars.bullet_1 = '{alive: 1'b1, rightward: from.facing_right, y: from.y, column: from.x};
    end
    acted_d.scalars.reload = (fires ? RELOAD_STEPS : from.reload) - {2'b00, fires | go_q & from.reload != '0};
    acted_d.scalars.facing_right = (from.facing_right | right) & ~left;
    acted_d.scalars.x = from.x + {3'b000, right & from.x < LAST_COLUMN} - {3'b000, left & from.x != '0};
    acted_d.scalars.y = from.y + {3'b000, down} - {3'b000, up};
  end

  // Third stage: own bullets move, the newer diver does.
  flow_t aimed_d, aimed_q;
  boarding_t boarding_1;
  enemy_plane_t at_newer_d, at_newer_q;

  assign boarding_1 = boarding(
      acted_q.scalars.diver_1,
      acted_q.scalars.x,
      acted_q.scalars.y,
      acted_q.scalars.divers < MAX_DIVERS,
      DIVERS_MOVED[acted_q.scalars.diver_timer],
      acted_q.go
  );

  always_comb begin
    aimed_d = acted_q;
    aimed_d.scalars.bullet_0 = flown(acted_q.scalars.bullet_0, acted_q.go);
    aimed_d.scalars.bullet_1 = flown(acted_q.scalars.bullet_1, acted_q.go);
    at_newer_d = in_row(acted_q.enemies.row, aimed_d.scalars.bullet_1.y) &
        in_column(acted_q.enemies.column, aimed_d.scalars.bullet_1.column) &
        {ENEMY_PLACES{acted_q.go & aimed_d.scalars.bullet_1.alive}};
    aimed_d.scalars.diver_1 = boarding_1.diver;
    aimed_d.scalars.divers = acted_q.scalars.divers + {15'd0, boarding_1.aboard};
  end

  // Fourth stage: the newer bullet strikes, the older diver moves.
  flow_t newer_d, newer_q;
  boarding_t boarding_0;
  enemy_plane_t at_older_d, at_older_q, struck_newer;

  assign boarding_0 = boarding(
      aimed_q.scalars.diver_0,
      aimed_q.scalars.x,
      aimed_q.scalars.y,
      aimed_q.scalars.divers < MAX_DIVERS,
      DIVERS_MOVED[aimed_q.scalars.diver_timer],
      aimed_q.go
  );
  assign struck_newer = first_struck(aimed_q.enemies.alive, aimed_q.enemies.submarine, at_newer_q);

  always_comb begin
    newer_d = aimed_q;
    newer_d.enemies.alive = aimed_q.enemies.alive ^ struck_newer;
    newer_d.scalars.bullet_1.alive = aimed_q.scalars.bullet_1.alive & struck_newer == '0;
    newer_d.struck = {1'b0, struck_newer != '0};
    at_older_d = in_row(aimed_q.enemies.row, aimed_q.scalars.bullet_0.y) &
        in_column(aimed_q.enemies.column, aimed_q.scalars.bullet_0.column) &
        {ENEMY_PLACES{aimed_q.go & aimed_q.scalars.bullet_0.alive}};
    newer_d.scalars.diver_0 = boarding_0.diver;
    newer_d.scalars.divers = aimed_q.scalars.divers + {15'd0, boarding_0.aboard};
  end

  // Fifth stage: the older bullet strikes.
  flow_t older_d, older_q;
  enemy_plane_t struck_older;

  assign struck_older = first_struck(newer_q.enemies.alive, newer_q.enemies.submarine, at_older_q);

  always_comb begin
    older_d = newer_q;
    older_d.enemies.alive = newer_q.enemies.alive ^ struck_older;
    older_d.scalars.bullet_0.alive = newer_q.scalars.bullet_0.alive & struck_older == '0;
    older_d.struck = newer_q.struck + {1'b0, struck_older != '0};
  end

  // Sixth stage: enemies meet the submarine where they are, and move.
  flow_t swum_d, swum_q;
  enemy_plane_t moves_d, moves_q, armed_q;
  enemy_plane_t carry_1, carry_2, carry_3;
  logic [2:0] interval_now;

  assign interval_now = move_interval(older_q.scalars.ramp);
  assign moves_d = ~(older_q.enemies.move[0] | older_q.enemies.move[1] | older_q.enemies.move[2]) & {ENEMY_PLACES{older_q.go}};
  // A carry goes on through ones to the right, a borrow through zeros to the left.
  assign carry_1 = moves_d & ~(older_q.enemies.column[0] ^ older_q.enemies.rightward);
  assign carry_2 = carry_1 & ~(older_q.enemies.column[1] ^ older_q.enemies.rightward);
  assign carry_3 = carry_2 & ~(older_q.enemies.column[2] ^ older_q.enemies.rightward);

  always_comb begin
    swum_d = older_q;
    swum_d.terminated = (older_q.enemies.alive & in_row(older_q.enemies.row, older_q.scalars.y) &
                         in_column(older_q.enemies.column, older_q.scalars.x)) != '0;
    swum_d.enemies.column[0] = older_q.enemies.column[0] ^ moves_d;
    swum_d.enemies.column[1] = older_q.enemies.column[1] ^ carry_1;
    swum_d.enemies.column[2] = older_q.enemies.column[2] ^ carry_2;
    swum_d.enemies.column[3] = older_q.enemies.column[3] ^ carry_3;
    if (older_q.go) begin
      // Counting down from 0 gives 7, of which the bits of the interval are kept.
      swum_d.enemies.move[0] = ~older_q.enemies.move[0] & ~(moves_d & ~{ENEMY_PLACES{interval_now[0]}});
      swum_d.enemies.move[1] = ~(older_q.enemies.move[1] ^ older_q.enemies.move[0]) &
          ~(moves_d & ~{ENEMY_PLACES{interval_now[1]}});
      swum_d.enemies.move[2] = (older_q.enemies.move[2] ^ ~(older_q.enemies.move[0] | older_q.enemies.move[1])) &
          ~(moves_d & ~{ENEMY_PLACES{interval_now[2]}});
      swum_d.enemies.alive = older_q.enemies.alive & ~(swum_d.enemies.column[3] &
                                              (swum_d.enemies.column[2] | swum_d.enemies.column[1]));
    end
  end

  // Seventh stage: they meet the submarine where they came to, or a bullet; submarines fire.
  flow_t met_d, met_q;
  enemy_plane_t arrived, there, elsewhere, struck_0, struck_1;
  enemy_plane_t waits, fire, low_d, low_q, high_d, high_q;

  assign arrived = swum_q.enemies.alive & moves_q;
  assign there = in_row(
      swum_q.enemies.row, swum_q.scalars.y
  ) & in_column(
      swum_q.enemies.column, swum_q.scalars.x
  );
  assign elsewhere = arrived & ~there;
  assign struck_0 = elsewhere & in_row(
      swum_q.enemies.row, swum_q.scalars.bullet_0.y
  ) & in_column(
      swum_q.enemies.column, swum_q.scalars.bullet_0.column
  ) & {ENEMY_PLACES{swum_q.scalars.bullet_0.alive}};
  assign struck_1 = elsewhere & in_row(
      swum_q.enemies.row, swum_q.scalars.bullet_1.y
  ) & in_column(
      swum_q.enemies.column, swum_q.scalars.bullet_1.column
  ) & {ENEMY_PLACES{swum_q.scalars.bullet_1.alive}} & ~struck_0;
  assign waits = swum_q.enemies.fire[0] | swum_q.enemies.fire[1] | swum_q.enemies.fire[2] | swum_q.enemies.fire[3];
  // A submarine that is struck now may still fire.
  assign fire = armed_q & swum_q.enemies.submarine & ~waits & {ENEMY_PLACES{swum_q.go}};
  assign low_d = lowest(fire);
  assign high_d = fire ^ low_d;

  always_comb begin
    met_d = swum_q;
    met_d.terminated = swum_q.terminated | (arrived & there) != '0;
    met_d.enemies.alive = swum_q.enemies.alive & ~(struck_0 | struck_1);
    met_d.scalars.bullet_0.alive = swum_q.scalars.bullet_0.alive & struck_0 == '0;
    met_d.scalars.bullet_1.alive = swum_q.scalars.bullet_1.alive & struck_1 == '0;
    met_d.struck = swum_q.struck + {1'b0, struck_0 != '0} + {1'b0, struck_1 != '0};
    if (swum_q.go) begin
      // Counting down from 0 gives 15, of which FIRE_INTERVAL is kept.
      met_d.enemies.fire[0] = ~swum_q.enemies.fire[0] & (waits | {ENEMY_PLACES{FIRE_INTERVAL[0]}});
      met_d.enemies.fire[1] = ~(swum_q.enemies.fire[1] ^ swum_q.enemies.fire[0]) & (waits | {ENEMY_PLACES{FIRE_INTERVAL[1]}});
      met_d.enemies.fire[2] = ~(swum_q.enemies.fire[2] ^ (swum_q.enemies.fire[0] | swum_q.enemies.fire[1])) &
          (waits | {ENEMY_PLACES{FIRE_INTERVAL[2]}});
      met_d.enemies.fire[3] = ~(swum_q.enemies.fire[3] ^ (swum_q.enemies.fire[0] | swum_q.enemies.fire[1] | swum_q.enemies.fire[2])) &
          (waits | {ENEMY_PLACES{FIRE_INTERVAL[3]}});
    end
  end

  // Eighth stage: what was fired joins the hostile bullets, the newer submarine's first.
  flow_t fired_d, fired_q;
  enemy_plane_t first;
  logic once, twice;
  logic [1:0] pushed_q;

  assign twice = high_q != '0;
  assign first = twice ? high_q : low_q;
  assign once  = first != '0;

  always_comb begin
    fired_d = met_q;
    fired_d.hostile.alive[BULLETS+:2] = {twice, once};
    fired_d.hostile.rightward[BULLETS+:2] = {
      (met_q.enemies.rightward & low_q) != '0, (met_q.enemies.rightward & first) != '0
    };
    for (int unsigned k = 0; k < 3; k++) begin
      fired_d.hostile.row[k][BULLETS+:2] = {
        (met_q.enemies.row[k] & low_q) != '0, (met_q.enemies.row[k] & first) != '0
      };
    end
    for (int unsigned k = 0; k < 4; k++) begin
      fired_d.hostile.column[k][BULLETS+:2] = {
        (met_q.enemies.column[k] & low_q) != '0, (met_q.enemies.column[k] & first) != '0
      };
    end
  end

  // Ninth stage: hostile bullets meet the submarine before they move and after; oxygen, the surface.
  state_t state_d, state_q;
  observation_t obs_d, obs_q;
  scalars_t last;
  hostile_t flying;
  bullet_plane_t flies, borrow_1, borrow_2, borrow_3, shot, hostile_alive;
  logic [3:0][BULLET_PLACES-1:0] hostile_column;
  logic submerged, rises, surfaces, full, stranded, terminated_d, terminated_q;
  logic [3:0] reward_d, reward_q;

  // oxygen / 20, given oxygen / 4: times 13 / 64.
  function automatic logic [3:0] bar(input logic [5:0] quarter);
    return 4'(({4'd0, quarter} + {2'd0, quarter, 2'd0} + {1'b0, quarter, 3'd0}) >> 6);
  endfunction

  assign last = fired_q.scalars;
  assign flying = fired_q.hostile;
  assign flies = {BULLET_PLACES{fired_q.go}};
  assign borrow_1 = flies & ~(flying.column[0] ^ flying.rightward);
  assign borrow_2 = borrow_1 & ~(flying.column[1] ^ flying.rightward);
  assign borrow_3 = borrow_2 & ~(flying.column[2] ^ flying.rightward);
  assign hostile_column = {
    flying.column[3] ^ borrow_3,
    flying.column[2] ^ borrow_2,
    flying.column[1] ^ borrow_1,
    flying.column[0] ^ flies
  };
  assign shot = flying.alive & hostile_in_row(
      flying.row, last.y
  ) & (hostile_in_column(
      flying.column, last.x
  ) | hostile_in_column(
      hostile_column, last.x
  ));
  assign hostile_alive = flying.alive &
      ~(flies & hostile_column[3] & (hostile_column[2] | hostile_column[1]));

  assign submerged = last.y != '0;
  assign rises = fired_q.go & ~submerged & ~last.surfaced;
  assign stranded = rises & last.divers == '0;
  assign surfaces = rises & last.divers != '0;
  assign full = surfaces & last.divers == MAX_DIVERS;
  assign terminated_d = fired_q.terminated | shot != '0 | last.oxygen == '0 | stranded;
  assign reward_d = {2'b00, fired_q.struck} + (full ? bar(last.oxygen[7:2]) : 4'd0);

  always_comb begin
    state_d.scalars = last;
    // MinAtar takes one more diver after it took all six.
    state_d.scalars.divers = (full ? 16'sd0 : last.divers) - {15'd0, surfaces & last.divers != LEAST_DIVERS};
    state_d.scalars.oxygen = surfaces ? MAX_OXYGEN :
        last.oxygen - {7'd0, fired_q.go & submerged & last.oxygen != '0};
    state_d.scalars.surfaced = (last.surfaced | surfaces) & ~(fired_q.go & submerged);
    state_d.scalars.ramp = last.ramp + {4'd0, surfaces & DIFFICULTY_RAMPING & last.ramp < LAST_RAMP};
    // Down by one place for an enemy that appeared, by one for each bullet fired.
    state_d.enemy_alive = ENEMIES'(fired_q.enemies.alive >> fired_q.appeared);
    state_d.enemy_submarine = ENEMIES'(fired_q.enemies.submarine >> fired_q.appeared);
    state_d.enemy_rightward = ENEMIES'(fired_q.enemies.rightward >> fired_q.appeared);
    state_d.hostile_alive = BULLETS'(hostile_alive >> pushed_q);
    state_d.hostile_rightward = BULLETS'(flying.rightward >> pushed_q);
    for (int unsigned k = 0; k < 3; k++) begin
      state_d.enemy_row[k]   = ENEMIES'(fired_q.enemies.row[k] >> fired_q.appeared);
      state_d.enemy_move[k]  = ENEMIES'(fired_q.enemies.move[k] >> fired_q.appeared);
      state_d.hostile_row[k] = BULLETS'(flying.row[k] >> pushed_q);
    end
    for (int unsigned k = 0; k < 4; k++) begin
      state_d.enemy_column[k]   = ENEMIES'(fired_q.enemies.column[k] >> fired_q.appeared);
      state_d.enemy_fire[k]     = ENEMIES'(fired_q.enemies.fire[k] >> fired_q.appeared);
      state_d.hostile_column[k] = BULLETS'(hostile_column[k] >> pushed_q);
    end
  end

  assign obs_d = '{
          x: state_d.scalars.x,
          y: state_d.scalars.y,
          facing_right: state_d.scalars.facing_right,
          oxygen_bar: bar(state_d.scalars.oxygen[7:2]),
          aboard: state_d.scalars.divers[2:0] & ~{3{state_d.scalars.divers[15]}},
          bullet_0: state_d.scalars.bullet_0,
          bullet_1: state_d.scalars.bullet_1,
          diver_0: state_d.scalars.diver_0,
          diver_1: state_d.scalars.diver_1,
          enemy_alive: state_d.enemy_alive,
          enemy_submarine: state_d.enemy_submarine,
          enemy_rightward: state_d.enemy_rightward,
          enemy_row: state_d.enemy_row,
          enemy_column: state_d.enemy_column,
          hostile_alive: state_d.hostile_alive,
          hostile_row: state_d.hostile_row,
          hostile_column: state_d.hostile_column
      };

  always_ff @(posedge clk_i) begin
    acted_q      <= acted_d;
    aimed_q      <= aimed_d;
    at_newer_q   <= at_newer_d;
    newer_q      <= newer_d;
    at_older_q   <= at_older_d;
    older_q      <= older_d;
    swum_q       <= swum_d;
    moves_q      <= moves_d;
    armed_q      <= older_q.enemies.alive;
    met_q        <= met_d;
    low_q        <= low_d;
    high_q       <= high_d;
    fired_q      <= fired_d;
    pushed_q     <= {1'b0, once} + {1'b0, twice};
    state_q      <= state_d;
    obs_q        <= obs_d;
    reward_q     <= reward_d;
    terminated_q <= terminated_d;
  end

  logic [LATENCY-1:0] valid_q;

  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[LATENCY-2:0], valid_i};
  end

  assign valid_o = valid_q[LATENCY-1];
  assign state_o = state_q;
  assign obs_o = obs_q;
  assign reward_o = reward_q;
  assign terminated_o = terminated_q;

endmodule

