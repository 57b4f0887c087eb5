// The core of FrozenLake: step.py in hardware. Pipelined, a slot a cycle.

// verilator lint_off DECLFILENAME
package frozen_lake_pkg;
  // verilator lint_on DECLFILENAME

  localparam int unsigned LATENCY = 3;
  localparam int unsigned II = 1;

  localparam int unsigned STATE_BITS = 6;
  localparam int unsigned ACTION_BITS = 2;
  localparam int unsigned OBS_BITS = 6;
  localparam int unsigned REWARD_BITS = 2;

  localparam int unsigned SIDE = 8;
  localparam int unsigned CELLS = SIDE * SIDE;

  typedef struct packed {
    logic [2:0] column;
    logic [2:0] row;
  } state_t;

endpackage

module frozen_lake_pe
  import frozen_lake_pkg::*;
#(
    // The map: of every kind of cell a mask, with the cell in row r and column c in bit 8 * r + c.
    parameter int unsigned ROWS = 4,
    parameter int unsigned COLUMNS = 4,
    parameter logic [CELLS-1:0] STARTS = 64'h1,
    parameter logic [CELLS-1:0] HOLES = 64'h1080a00,
    parameter logic [CELLS-1:0] GOALS = 64'h8000000,
    // Whether an action is turned: to action - 1 where the draw is below TURNS_BACK, and to
    // action + 1 where it is TURNS_ON or above.
    parameter bit IS_SLIPPERY = 1'b1,
    parameter logic [31:0] TURNS_BACK = 32'h55555555,
    parameter logic [31:0] TURNS_ON = 32'haaaaaaab,

    // Where an episode starts is drawn if there is a choice.
    localparam int unsigned N_STARTS = $countones(STARTS),
    localparam int unsigned RESET_DRAWS = N_STARTS > 1 ? 1 : 0,
    localparam int unsigned STEP_DRAWS = IS_SLIPPERY ? 1 : 0,
    localparam int unsigned RNG_WORDS = RESET_DRAWS + STEP_DRAWS > 1 ? 2 : 1
) (
    input logic                         clk_i,
    input logic                         rst_ni,
    input logic                         valid_i,
    // Start from an initial state, not from state_i.
    input logic                         first_i,
    // Do not step: the result is the state started from and its observation.
    input logic                         hold_i,
    input state_t                       state_i,
    input logic   [          1:0]       action_i,
    // The random draws of this slot and step, the one for the initial state first.
    input logic   [RNG_WORDS-1:0][31:0] rng_i,

    output logic         valid_o,
    output state_t       state_o,
    output logic   [5:0] obs_o,
    // 0 for reaching a goal, 1 for a hole, 2 for anything else.
    output logic   [1:0] reward_o,
    output logic         terminated_o
);

  localparam logic [1:0] LEFT = 2'd0;
  localparam logic [1:0] DOWN = 2'd1;
  localparam logic [1:0] RIGHT = 2'd2;
  localparam logic [1:0] UP = 2'd3;
  localparam logic [2:0] LAST_ROW = 3'(ROWS - 1);
  localparam logic [2:0] LAST_COLUMN = 3'(COLUMNS - 1);

  if (ROWS < 1 || ROWS > SIDE || COLUMNS < 1 || COLUMNS > SIDE) begin : gen_bad_size
    $fatal(1, "a lake of %0d x %0d cells; possible are 1 to %0d each way", ROWS, COLUMNS, SIDE);
  end
  if (N_STARTS == 0) begin : gen_no_start
    $fatal(1, "STARTS is 0; an episode needs a cell to start in");
  end

  // The k-th start, in the order of the cells.
  typedef logic [CELLS-1:0][5:0] cells_t;
  function automatic cells_t start_cells();
    int unsigned k = 0;
    start_cells = '0;
    for (int unsigned i = 0; i < CELLS; i++) begin
      if (STARTS[i]) begin
        start_cells[k] = 6'(i);
        k++;
      end
    end
  endfunction
  localparam cells_t START_CELLS = start_cells();

  // First stage: which start, and which way.
  state_t state_q;
  logic [5:0] start_q;
  logic [1:0] action_d, action_q;
  logic first_q, hold_q;

  if (RESET_DRAWS != 0) begin : gen_choice
    // uniform_below(draw, N_STARTS)
    logic [37:0] product;
    logic unused_product;
    assign product = {6'b0, rng_i[0]} * 38'(N_STARTS);
    assign unused_product = ^product[31:0];
    always_ff @(posedge clk_i) start_q <= product[37:32];
  end else begin : gen_no_choice
    assign start_q = '0;
  end

  if (IS_SLIPPERY) begin : gen_slippery
    logic [31:0] draw;
    assign draw = rng_i[RNG_WORDS-1];
    assign action_d = action_i + {1'b0, draw >= TURNS_BACK} + {1'b0, draw >= TURNS_ON} + 2'd3;
  end else begin : gen_dry
    assign action_d = action_i;
  end

  if (RESET_DRAWS + STEP_DRAWS == 0) begin : gen_no_draw
    logic unused_rng;
    assign unused_rng = ^rng_i;
  end

  always_ff @(posedge clk_i) begin
    state_q  <= state_i;
    action_q <= action_d;
    first_q  <= first_i;
    hold_q   <= hold_i;
  end

  // Second stage: the move.
  state_t from, moved_d, moved_q;
  logic left, down, right, up;

  always_comb begin
    from = state_q;
    if (first_q) {from.row, from.column} = START_CELLS[start_q];
  end
  assign left = !hold_q & action_q == LEFT & from.column != '0;
  assign down = !hold_q & action_q == DOWN & from.row < LAST_ROW;
  assign right = !hold_q & action_q == RIGHT & from.column < LAST_COLUMN;
  assign up = !hold_q & action_q == UP & from.row != '0;
  assign moved_d.row = from.row + {2'b00, down} - {2'b00, up};
  assign moved_d.column = from.column + {2'b00, right} - {2'b00, left};

  always_ff @(posedge clk_i) moved_q <= moved_d;

  // Third stage: what is there.
  logic goal, hole;
  assign goal = GOALS[{moved_q.row, moved_q.column}];
  assign hole = HOLES[{moved_q.row, moved_q.column}];

  always_ff @(posedge clk_i) begin
    state_o <= moved_q;
    obs_o <= {3'b000, moved_q.row} * 6'(COLUMNS) + {3'b000, moved_q.column};
    reward_o <= 2'd2 - {goal, hole};
    terminated_o <= goal | hole;
  end

  logic [LATENCY-1:0] valid_q;
  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[LATENCY-2:0], valid_i};
  end
  assign valid_o = valid_q[LATENCY-1];

endmodule
