// SPDX-License-Identifier: MIT
// A network's layers, for many rows in lockstep: LANES rows at a time, PRODUCTS products of each a cycle.
//
// Groups of rows come in and are kept until SIDE * ROUNDS of them make a batch. Those SIDE groups that stand side
// by side share their weights, and rounds follow each other, so that a layer's last sums of one round come out of
// the pipeline while the next one's go in. Of a batch a layer takes outputs * ROUNDS * chunks cycles, and the
// pipeline runs empty between two layers, which takes LAYER_GAP more. While a batch is computed the next one comes
// in, and the logits of the one before go out. Its user sees to it that no more than two batches are in it.
module pearl_network
  import pearl_pkg::*;
#(
    // Rows of a group; groups side by side; one after the other.
    parameter int unsigned GROUP = 4,
    parameter int unsigned SIDE = 2,
    parameter int unsigned ROUNDS = 2,
    // The most numbers that a row of each kind has, and the most layers.
    parameter int unsigned INPUTS = 4,
    parameter int unsigned HIDDEN = 8,
    parameter int unsigned OUTPUTS = 2,
    parameter int unsigned LAYERS = 3,
    parameter int unsigned PRODUCTS = 4,
    parameter int unsigned WEIGHT_BITS = 8,
    parameter int unsigned VALUE_BITS = 12,
    // Words of weights, PRODUCTS in each.
    parameter int unsigned WEIGHT_WORDS = 64,
    parameter int unsigned INDEX_BITS = 12
) (
    input logic clk_i,
    input logic rst_ni,

    // The host's words: a number at an index of a section.
    input logic [NumSections-1:0] we_i,
    input logic [ INDEX_BITS-1:0] index_i,
    input logic [           31:0] wdata_i,

    // PRODUCTS inputs of each row of a group, one word of them after the other; whether the group is the last one.
    input logic                                           valid_i,
    input logic                                           last_i,
    input logic [GROUP-1:0][PRODUCTS-1:0][VALUE_BITS-1:0] values_i,

    // The logits of a group, in the order in which groups came.
    output logic                                        valid_o,
    output logic [GROUP-1:0][OUTPUTS-1:0][SUM_BITS-1:0] logits_o
);

  localparam int unsigned LANES = SIDE * GROUP;
  localparam int unsigned BATCH = SIDE * ROUNDS;
  localparam int unsigned INPUT_CHUNKS = ceil_div(INPUTS, PRODUCTS);
  localparam int unsigned HIDDEN_CHUNKS = ceil_div(HIDDEN, PRODUCTS);
  localparam int unsigned INPUT_DEPTH = ROUNDS * INPUT_CHUNKS;
  localparam int unsigned HIDDEN_DEPTH = ROUNDS * HIDDEN_CHUNKS;
  localparam int unsigned BIASES = (LAYERS - 1) * HIDDEN + OUTPUTS;
  localparam int unsigned WORD_BITS = PRODUCTS * WEIGHT_BITS;

  localparam int unsigned SIDE_BITS = index_bits(SIDE);
  localparam int unsigned ROUND_BITS = index_bits(ROUNDS);
  localparam int unsigned COUNT_BITS = $clog2(BATCH + 1);
  localparam int unsigned INPUT_BITS = index_bits(INPUT_DEPTH);
  localparam int unsigned HIDDEN_BITS = index_bits(HIDDEN_DEPTH);
  localparam int unsigned CHUNK_BITS = $clog2(at_least(INPUT_CHUNKS, HIDDEN_CHUNKS) + 1);
  localparam int unsigned OUTPUT_BITS = $clog2(at_least(HIDDEN, OUTPUTS) + 1);
  localparam int unsigned LAYER_BITS = index_bits(LAYERS);
  localparam int unsigned PRODUCT_BITS = index_bits(PRODUCTS);
  localparam int unsigned WEIGHT_ADDR_BITS = index_bits(WEIGHT_WORDS);
  localparam int unsigned BIAS_ADDR_BITS = index_bits(BIASES);

  // Cycles from a read of operands to when they are at the lanes, to their sum, and to its value.
  localparam int unsigned TO_LANE = READ_LATENCY + 1;
  localparam int unsigned TO_FIRST = TO_LANE + $clog2(PRODUCTS) + 1;
  localparam int unsigned TO_SUM = TO_FIRST + 1;
  localparam int unsigned TO_VALUE = TO_SUM + LANE_VALUE;
  localparam int unsigned LAYER_GAP = TO_VALUE;
  localparam int unsigned GAP_BITS = $clog2(LAYER_GAP + 1);

  // Of some sections, and of the numbers as many bits as they have.
  logic unused_host;
  assign unused_host = ^{we_i, index_i, wdata_i};

  // ---- What the host says of the layers ----

  layer_t layers_q[LAYERS];
  logic [LAYER_BITS-1:0] last_layer_q;

  always_ff @(posedge clk_i) begin
    if (we_i[Settings]) begin
      if (index_i == INDEX_BITS'(SETTING_COUNT)) last_layer_q <= wdata_i[LAYER_BITS-1:0];
      for (int unsigned i = 0; i < LAYERS; i++) begin
        if (index_i == INDEX_BITS'(SETTING_LAYERS + 2 * i)) layers_q[i][31:0] <= wdata_i;
        if (index_i == INDEX_BITS'(SETTING_LAYERS + 2 * i + 1)) layers_q[i][63:32] <= wdata_i;
      end
    end
  end

  // ---- Groups come in ----

  // Of each of two batches: how many groups it has, and whether it has all that it will have.
  logic [1:0] full_q;
  logic [1:0][COUNT_BITS-1:0] counts_q;
  logic into_q, take, chunk_last, side_last, batch_last;
  logic from_q;
  logic [index_bits(INPUT_CHUNKS)-1:0] chunk_in_q;
  logic [SIDE_BITS-1:0] side_in_q;
  logic [INPUT_BITS-1:0] round_in_q;
  logic [COUNT_BITS-1:0] count_in_q;

  assign chunk_last = 32'(chunk_in_q) == INPUT_CHUNKS - 1;
  assign side_last  = 32'(side_in_q) == SIDE - 1;
  assign batch_last = chunk_last && (last_i || 32'(count_in_q) == BATCH - 1);

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      full_q     <= '0;
      into_q     <= 1'b0;
      chunk_in_q <= '0;
      side_in_q  <= '0;
      round_in_q <= '0;
      count_in_q <= '0;
    end else begin
      if (take) full_q[from_q] <= 1'b0;
      if (valid_i) begin
        chunk_in_q <= chunk_last ? '0 : chunk_in_q + 1'b1;
        if (chunk_last) begin
          count_in_q <= count_in_q + 1'b1;
          side_in_q  <= side_last ? '0 : side_in_q + 1'b1;
          if (side_last) round_in_q <= round_in_q + INPUT_BITS'(INPUT_CHUNKS);
        end
        if (batch_last) begin
          full_q[into_q] <= 1'b1;
          into_q         <= !into_q;
          side_in_q      <= '0;
          round_in_q     <= '0;
          count_in_q     <= '0;
        end
      end
    end
  end

  always_ff @(posedge clk_i) begin
    if (valid_i && batch_last) counts_q[into_q] <= count_in_q + 1'b1;
  end

  // ---- The order of products ----

  typedef enum logic [1:0] {
    Idle,
    Layer,
    Gap
  } state_e;

  state_e state_q;
  logic [1:0] held_q;
  layer_t layer_q;
  logic [LAYER_BITS-1:0] number_q;
  logic [GAP_BITS-1:0] gap_q;
  logic [CHUNK_BITS-1:0] chunk_q;
  logic [ROUND_BITS-1:0] round_q;
  logic [OUTPUT_BITS-1:0] output_q;
  logic [PRODUCT_BITS-1:0] column_q;
  logic [HIDDEN_BITS-1:0] value_addr_q, value_chunk_q;
  logic [at_least(INPUT_BITS, HIDDEN_BITS)-1:0] operand_q;
  logic [WEIGHT_ADDR_BITS-1:0] weight_q, output_weight_q;
  logic [BIAS_ADDR_BITS-1:0] bias_q;
  // Of the batch that is computed, where logits go; and which half of the hidden memory a layer's values go to.
  logic logit_bank_q, half_q, inputs_q;
  logic [HIDDEN_BITS-1:0] next_chunks;
  logic running, first_chunk, last_chunk, last_round, last_output, last_layer, freed, freed_bank;

  assign running     = state_q == Layer;
  assign first_chunk = chunk_q == '0;
  assign last_chunk  = 32'(chunk_q) + 1 == 32'(layer_q.chunks);
  assign last_round  = 32'(round_q) == ROUNDS - 1;
  assign last_output = 32'(output_q) + 1 == 32'(layer_q.outputs);
  assign last_layer  = number_q == last_layer_q;
  assign take        = state_q == Idle && full_q[from_q] && !held_q[logit_bank_q];
  // Values of a layer are the operands of the next one, as many words for each round.
  assign next_chunks = HIDDEN_BITS'(layers_q[last_layer?number_q : number_q+1'b1].chunks);

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      state_q      <= Idle;
      from_q       <= 1'b0;
      logit_bank_q <= 1'b0;
      half_q       <= 1'b0;
      held_q       <= '0;
    end else begin
      if (take) held_q[logit_bank_q] <= 1'b1;
      if (freed) held_q[freed_bank] <= 1'b0;
      unique case (state_q)
        Idle:    if (take) state_q <= Layer;
        Layer:
        if (last_chunk && last_round && last_output) begin
          state_q <= last_layer ? Idle : Gap;
          half_q  <= !half_q;
          if (last_layer) begin
            from_q       <= !from_q;
            logit_bank_q <= !logit_bank_q;
          end
        end
        default: if (gap_q == '0) state_q <= Layer;
      endcase
    end
  end

  always_ff @(posedge clk_i) begin
    unique case (state_q)
      Idle: begin
        layer_q         <= layers_q[0];
        number_q        <= '0;
        weight_q        <= '0;
        output_weight_q <= '0;
        bias_q          <= '0;
        inputs_q        <= 1'b1;
        gap_q           <= '0;
      end
      Layer: begin
        gap_q     <= GAP_BITS'(LAYER_GAP - 1);
        chunk_q   <= last_chunk ? '0 : chunk_q + 1'b1;
        operand_q <= operand_q + 1'b1;
        weight_q  <= weight_q + 1'b1;
        if (last_chunk) begin
          round_q      <= last_round ? '0 : round_q + 1'b1;
          value_addr_q <= value_addr_q + next_chunks;
          weight_q     <= output_weight_q;
          if (last_round) begin
            operand_q       <= '0;
            output_q        <= output_q + 1'b1;
            bias_q          <= bias_q + 1'b1;
            weight_q        <= weight_q + 1'b1;
            output_weight_q <= weight_q + 1'b1;
            column_q        <= 32'(column_q) == PRODUCTS - 1 ? '0 : column_q + 1'b1;
            if (32'(column_q) == PRODUCTS - 1) begin
              value_chunk_q <= value_chunk_q + 1'b1;
              value_addr_q  <= value_chunk_q + 1'b1;
            end else begin
              value_addr_q <= value_chunk_q;
            end
          end
        end
      end
      default: begin
        gap_q    <= gap_q - 1'b1;
        inputs_q <= 1'b0;
        if (gap_q == '0) begin
          number_q <= number_q + 1'b1;
          layer_q  <= layers_q[number_q+1'b1];
        end
      end
    endcase
    if (state_q != Layer) begin
      chunk_q       <= '0;
      round_q       <= '0;
      output_q      <= '0;
      column_q      <= '0;
      value_addr_q  <= '0;
      value_chunk_q <= '0;
      operand_q     <= '0;
    end
  end

  // ---- Operands ----

  logic [SIDE-1:0][GROUP-1:0][PRODUCTS-1:0][VALUE_BITS-1:0] inputs;
  logic [PRODUCTS-1:0][LANES-1:0][VALUE_BITS-1:0] hidden;
  logic [LANES-1:0][PRODUCTS-1:0][VALUE_BITS-1:0] values_q;
  logic [PRODUCTS-1:0][WEIGHT_BITS-1:0] weights_q;
  logic [LANES-1:0][VALUE_BITS-1:0] made;
  logic of_inputs, made_we, made_half;
  logic [PRODUCT_BITS-1:0] made_column;
  logic [ HIDDEN_BITS-1:0] made_addr;

  for (genvar i = 0; i < SIDE; i++) begin : gen_inputs
    pearl_ram #(
        .WIDTH(GROUP * PRODUCTS * VALUE_BITS),
        .DEPTH(2 << INPUT_BITS)
    ) u_inputs (
        .clk_i,
        .we_i   (valid_i && 32'(side_in_q) == i),
        .waddr_i({into_q, round_in_q + INPUT_BITS'(chunk_in_q)}),
        .wdata_i(values_i),
        .re_i   (running && inputs_q),
        .raddr_i({from_q, operand_q[INPUT_BITS-1:0]}),
        .rdata_o(inputs[i])
    );
  end

  for (genvar i = 0; i < PRODUCTS; i++) begin : gen_hidden
    pearl_ram #(
        .WIDTH(LANES * VALUE_BITS),
        .DEPTH(2 << HIDDEN_BITS)
    ) u_hidden (
        .clk_i,
        .we_i   (made_we && 32'(made_column) == i),
        .waddr_i({made_half, made_addr}),
        .wdata_i(made),
        .re_i   (running && !inputs_q),
        .raddr_i({!half_q, operand_q[HIDDEN_BITS-1:0]}),
        .rdata_o(hidden[i])
    );
  end

  // A word of weights is as many of the host's words as it takes, a power of two of them.
  localparam int unsigned COLUMNS = ceil_div(WORD_BITS, 32);
  localparam int unsigned COLUMNS_LOG2 = $clog2(COLUMNS);
  logic [COLUMNS-1:0][31:0] weight_word;
  logic [COLUMNS*32-1:0] weight_bits;
  logic unused_weights;
  assign weight_bits = weight_word;
  // The last of them may have a part that is none of the weights.
  assign unused_weights = ^weight_bits;

  for (genvar i = 0; i < COLUMNS; i++) begin : gen_weights
    localparam int unsigned WIDTH = (i + 1) * 32 > WORD_BITS ? WORD_BITS - i * 32 : 32;
    logic chosen;
    if (COLUMNS > 1) begin : gen_columns
      assign chosen = index_i[COLUMNS_LOG2-1:0] == COLUMNS_LOG2'(i);
    end else begin : gen_column
      assign chosen = 1'b1;
    end
    logic [WIDTH-1:0] rdata;
    pearl_ram #(
        .WIDTH(WIDTH),
        .DEPTH(WEIGHT_WORDS)
    ) u_weights (
        .clk_i,
        .we_i   (we_i[Weights] && chosen),
        .waddr_i(index_i[COLUMNS_LOG2+:WEIGHT_ADDR_BITS]),
        .wdata_i(wdata_i[WIDTH-1:0]),
        .re_i   (running),
        .raddr_i(weight_q),
        .rdata_o(rdata)
    );
    assign weight_word[i] = 32'(rdata);
  end

  logic [SUM_BITS-1:0] bias, bias_late;
  pearl_ram #(
      .WIDTH(SUM_BITS),
      .DEPTH(BIASES)
  ) u_biases (
      .clk_i,
      .we_i   (we_i[Biases]),
      .waddr_i(index_i[BIAS_ADDR_BITS-1:0]),
      .wdata_i(wdata_i),
      .re_i   (running),
      .raddr_i(bias_q),
      .rdata_o(bias)
  );

  pearl_delay #(
      .WIDTH (1),
      .STAGES(READ_LATENCY)
  ) u_of_inputs (
      .clk_i,
      .d_i(inputs_q),
      .d_o(of_inputs)
  );

  always_ff @(posedge clk_i) begin
    weights_q <= weight_bits[WORD_BITS-1:0];
    for (int unsigned lane = 0; lane < LANES; lane++) begin
      for (int unsigned i = 0; i < PRODUCTS; i++) begin
        values_q[lane][i] <= of_inputs ? inputs[lane/GROUP][lane%GROUP][i] : hidden[i][lane];
      end
    end
  end

  // ---- Where sums are on their way ----

  typedef struct packed {
    logic first;
    logic last_layer;
    logic logit_bank;
    logic half;
    logic [PRODUCT_BITS-1:0] column;
    logic [HIDDEN_BITS-1:0] addr;
    logic [OUTPUT_BITS-1:0] number;
    logic [ROUND_BITS-1:0] round;
    logic ends;
  } way_t;

  way_t way, at_first, at_sum, at_value;
  // A sum is complete with these products.
  logic [TO_VALUE:1] done_q;

  assign way = '{
          first: first_chunk,
          last_layer: last_layer,
          logit_bank: logit_bank_q,
          half: half_q,
          column: column_q,
          addr: value_addr_q,
          number: output_q,
          round: round_q,
          ends: last_output && last_round
      };

  always_ff @(posedge clk_i) begin
    if (!rst_ni) done_q <= '0;
    else done_q <= {done_q[TO_VALUE-1:1], running && last_chunk};
  end

  pearl_delay #(
      .WIDTH ($bits(way_t)),
      .STAGES(TO_FIRST)
  ) u_to_first (
      .clk_i,
      .d_i(way),
      .d_o(at_first)
  );
  pearl_delay #(
      .WIDTH ($bits(way_t)),
      .STAGES(TO_SUM - TO_FIRST)
  ) u_to_sum (
      .clk_i,
      .d_i(at_first),
      .d_o(at_sum)
  );
  pearl_delay #(
      .WIDTH ($bits(way_t)),
      .STAGES(TO_VALUE - TO_SUM)
  ) u_to_value (
      .clk_i,
      .d_i(at_sum),
      .d_o(at_value)
  );
  pearl_delay #(
      .WIDTH (SUM_BITS),
      .STAGES(TO_FIRST - READ_LATENCY)
  ) u_bias (
      .clk_i,
      .d_i(bias),
      .d_o(bias_late)
  );
  assign made_we = done_q[TO_VALUE] && !at_value.last_layer;
  assign made_half = at_value.half;
  assign made_column = at_value.column;
  assign made_addr = at_value.addr;
  // Each of these is used in a part.
  logic unused_way;
  assign unused_way = ^{at_first, at_sum, at_value};

  logic [LANES-1:0][SUM_BITS-1:0] sums;

  for (genvar i = 0; i < LANES; i++) begin : gen_lane
    pearl_lane #(
        .PRODUCTS   (PRODUCTS),
        .WEIGHT_BITS(WEIGHT_BITS),
        .VALUE_BITS (VALUE_BITS)
    ) u_lane (
        .clk_i,
        .weights_i    (weights_q),
        .values_i     (values_q[i]),
        .first_i      (at_first.first),
        .bias_i       (bias_late),
        .sum_o        (sums[i]),
        .layer_i      (layer_q),
        .value_o      (made[i]),
        .table_we_i   (we_i[Activation]),
        .table_addr_i (index_i[ENTRY_BITS-1:0]),
        .table_wdata_i(wdata_i[VALUE_BITS-1:0])
    );
  end

  // ---- Logits go out, a group a cycle ----

  logic [SIDE-1:0][OUTPUTS-1:0][GROUP-1:0][SUM_BITS-1:0] logits;
  logic logit_we, ready_set;
  logic [1:0] ready_q;
  logic out_bank_q, out_running, out_last;
  logic [COUNT_BITS-1:0] out_left_q;
  logic [SIDE_BITS-1:0] out_side_q, out_side;
  logic [ROUND_BITS-1:0] out_round_q;
  logic [1:0][COUNT_BITS-1:0] sizes_q;
  logic [READ_LATENCY+1:1] out_valid_q;

  assign logit_we  = done_q[TO_SUM] && at_sum.last_layer;
  assign ready_set = logit_we && at_sum.ends;

  for (genvar i = 0; i < SIDE; i++) begin : gen_logits
    for (genvar k = 0; k < OUTPUTS; k++) begin : gen_output
      pearl_ram #(
          .WIDTH(GROUP * SUM_BITS),
          .DEPTH(2 << ROUND_BITS)
      ) u_logits (
          .clk_i,
          .we_i   (logit_we && 32'(at_sum.number) == k),
          .waddr_i({at_sum.logit_bank, at_sum.round}),
          .wdata_i(sums[i*GROUP+:GROUP]),
          .re_i   (out_running),
          .raddr_i({out_bank_q, out_round_q}),
          .rdata_o(logits[i][k])
      );
    end
  end

  assign out_running = ready_q[out_bank_q];
  assign out_last    = out_left_q + COUNT_BITS'(1) == sizes_q[out_bank_q];
  assign freed       = out_running && out_last;
  assign freed_bank  = out_bank_q;

  always_ff @(posedge clk_i) begin
    if (take) sizes_q[logit_bank_q] <= counts_q[from_q];
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      ready_q     <= '0;
      out_bank_q  <= 1'b0;
      out_left_q  <= '0;
      out_side_q  <= '0;
      out_round_q <= '0;
      out_valid_q <= '0;
    end else begin
      if (ready_set) ready_q[at_sum.logit_bank] <= 1'b1;
      out_valid_q <= {out_valid_q[READ_LATENCY:1], out_running};
      if (out_running) begin
        out_left_q <= out_left_q + 1'b1;
        out_side_q <= 32'(out_side_q) == SIDE - 1 ? '0 : out_side_q + 1'b1;
        if (32'(out_side_q) == SIDE - 1) out_round_q <= out_round_q + 1'b1;
        if (out_last) begin
          ready_q[out_bank_q] <= 1'b0;
          out_bank_q          <= !out_bank_q;
          out_left_q          <= '0;
          out_side_q          <= '0;
          out_round_q         <= '0;
        end
      end
    end
  end

  pearl_delay #(
      .WIDTH (SIDE_BITS),
      .STAGES(READ_LATENCY)
  ) u_out_side (
      .clk_i,
      .d_i(out_side_q),
      .d_o(out_side)
  );

  logic [GROUP-1:0][OUTPUTS-1:0][SUM_BITS-1:0] logits_q;
  always_ff @(posedge clk_i) begin
    for (int unsigned row = 0; row < GROUP; row++) begin
      for (int unsigned k = 0; k < OUTPUTS; k++) begin
        logits_q[row][k] <= logits[out_side][k][row];
      end
    end
  end
  assign valid_o  = out_valid_q[READ_LATENCY+1];
  assign logits_o = logits_q;

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (!valid_i || !full_q[into_q])
      else $error("pearl_network: a group came when there was no room for it");
    end
  end

endmodule
